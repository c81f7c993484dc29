//! Where errors in generated code are shown.

use proc_macro2::{Group, Span, TokenStream, TokenTree};

/// The tokens at a place in the author's code. All of them must be there, since the compiler shows an
/// expression whose tokens are at different places at the derive macro.
pub fn at(place: Span, tokens: TokenStream) -> TokenStream {
    let span = Span::call_site().located_at(place);
    let moved = tokens.into_iter().map(|mut token| {
        if let TokenTree::Group(group) = &token {
            token = Group::new(group.delimiter(), at(place, group.stream())).into();
        }
        token.set_span(span);
        token
    });
    moved.collect()
}
