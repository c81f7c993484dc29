"""Results of the same FMUs beyond the paper. One module per section of the page."""
