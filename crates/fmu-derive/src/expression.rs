//! Expressions in attributes, as far as the macros look into them: literals, and arrays.

use std::fmt::{self, Display, Formatter};

use proc_macro2::{Delimiter, Group, Span, TokenStream, TokenTree};
use quote::{ToTokens, quote};
use syn::parse::{Parse, ParseStream, Parser};
use syn::punctuated::Punctuated;
use syn::spanned::Spanned;
use syn::{Lit, LitFloat, Result, Token};

/// An expression.
#[derive(Clone)]
pub struct Expression {
    tokens: TokenStream,
    pub form: Form,
}

/// What an expression is.
#[derive(Clone)]
pub enum Form {
    Literal(Lit),
    /// `[a, b]`
    Array(Vec<Expression>),
    /// `[a; n]`
    Repeat(Box<Expression>, TokenStream),
    Other,
}

impl Parse for Expression {
    /// Parses an expression to the next comma that is not between generic arguments.
    fn parse(input: ParseStream<'_>) -> Result<Self> {
        let (mut tokens, mut depth) = (TokenStream::new(), 0);
        while !input.is_empty() && (depth > 0 || !input.peek(Token![,])) {
            let is_path = input.peek(Token![::]) && input.peek3(Token![<]);
            let is_open = is_path || depth > 0 && input.peek(Token![<]);
            let is_closed = depth > 0 && input.peek(Token![>]);
            depth = depth + usize::from(is_open) - usize::from(is_closed);
            for _ in 0..if is_path { 3 } else { 1 } {
                tokens.extend([input.parse::<TokenTree>()?]);
            }
        }
        match tokens.is_empty() {
            true => Err(input.error("expected an expression")),
            false => Ok(Self::from_tokens(tokens)),
        }
    }
}

impl Expression {
    fn from_tokens(tokens: TokenStream) -> Self {
        let mut trees = tokens.clone().into_iter();
        let form = match (trees.next(), trees.next()) {
            (Some(TokenTree::Group(group)), None) => match group.delimiter() {
                // Invisible parentheses, which `macro_rules!` adds.
                Delimiter::None => return Self::from_tokens(group.stream()),
                Delimiter::Parenthesis => Self::from_tokens(group.stream()).form,
                Delimiter::Bracket => bracket_form(group.stream()).unwrap_or(Form::Other),
                Delimiter::Brace => Form::Other,
            },
            _ => syn::parse2(tokens.clone()).map_or(Form::Other, Form::Literal),
        };
        Self { tokens, form }
    }

    /// Whether it is a single literal value.
    pub fn is_literal(&self) -> bool {
        matches!(self.form, Form::Literal(_))
    }

    /// The first element of the innermost array, or the expression itself; and in how many arrays it is.
    pub fn innermost(&self) -> (&Self, usize) {
        let inner = match &self.form {
            Form::Array(elements) => elements.first(),
            Form::Repeat(element, _) => Some(&**element),
            _ => None,
        };
        inner.map_or((self, 0), |inner| {
            let (innermost, depth) = inner.innermost();
            (innermost, depth + 1)
        })
    }

    /// Whether it depends on the fields of the struct.
    pub fn uses_self(&self) -> bool {
        uses_self(self.tokens.clone())
    }

    /// The value of a literal number.
    pub fn number(&self) -> Option<f64> {
        match &self.form {
            Form::Literal(Lit::Int(number)) => number.base10_parse().ok(),
            Form::Literal(Lit::Float(number)) => number.base10_parse().ok(),
            _ => None,
        }
    }

    /// The expression in the type f64 or f32: whole numbers get a fraction.
    pub fn real(&self) -> TokenStream {
        match &self.form {
            Form::Literal(Lit::Int(number)) if number.suffix().is_empty() => {
                LitFloat::new(&format!("{}.0", number.base10_digits()), number.span())
                    .to_token_stream()
            }
            Form::Array(elements) => {
                let elements = elements.iter().map(Self::real);
                quote!([#(#elements),*])
            }
            Form::Repeat(element, length) => {
                let element = element.real();
                quote!([#element; #length])
            }
            _ => self.authored(),
        }
    }

    /// The value of an option, which the compiler checks to be positive.
    pub fn positive(&self, option: &str, krate: &TokenStream) -> TokenStream {
        let (value, message) = (self.real(), format!("`{option}` is "));
        respan(self.span(), quote!(#krate::positive(#value, #message)))
    }

    /// The author's tokens in invisible parentheses, between which they keep their places: the compiler checks code
    /// of macros less, and would not report literals that overflow.
    pub fn authored(&self) -> TokenStream {
        Group::new(Delimiter::None, self.tokens.clone()).to_token_stream()
    }
}

/// Moves tokens to a place in the author's code, where the compiler shows errors. All of them must be there, since
/// it shows an expression whose tokens are at different places at the derive macro. Tokens in invisible parentheses
/// stay where they are: see [`Expression::authored`].
pub fn respan(span: Span, tokens: TokenStream) -> TokenStream {
    let here = Span::call_site().located_at(span);
    let moved = tokens.into_iter().map(|mut token| {
        if let TokenTree::Group(group) = &token {
            if group.delimiter() == Delimiter::None {
                return token;
            }
            token = Group::new(group.delimiter(), respan(span, group.stream())).into();
        }
        token.set_span(here);
        token
    });
    moved.collect()
}

fn uses_self(tokens: TokenStream) -> bool {
    tokens.into_iter().any(|token| match token {
        TokenTree::Ident(ident) => ident == "self",
        TokenTree::Group(group) => uses_self(group.stream()),
        _ => false,
    })
}

/// The form of the tokens between brackets.
fn bracket_form(inner: TokenStream) -> Option<Form> {
    let trees: Vec<TokenTree> = inner.clone().into_iter().collect();
    let is_semicolon = |tree: &TokenTree| matches!(tree, TokenTree::Punct(p) if p.as_char() == ';');
    if let Some(at) = trees.iter().position(is_semicolon) {
        let part = |trees: &[TokenTree]| trees.iter().cloned().collect();
        let element = Expression::from_tokens(part(&trees[..at]));
        return Some(Form::Repeat(Box::new(element), part(&trees[at + 1..])));
    }
    let elements = Punctuated::<Expression, Token![,]>::parse_terminated;
    let elements = elements.parse2(inner).ok()?;
    Some(Form::Array(elements.into_iter().collect()))
}

/// Shows it as it is written.
impl Display for Expression {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        self.tokens.fmt(f)
    }
}

impl ToTokens for Expression {
    fn to_tokens(&self, tokens: &mut TokenStream) {
        tokens.extend(self.tokens.clone());
    }
}
