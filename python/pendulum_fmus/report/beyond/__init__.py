"""What the same FMUs show beyond the paper. One module per section of the page."""
