//! Source files as tokens, without everything that cannot change their meaning.

use proc_macro2::{Delimiter, Spacing, TokenStream, TokenTree};

/// The tokens of a Rust file without comments, docs and items under `#[cfg(test)]`.
pub(crate) fn rust_tokens(source: &str) -> Result<String, proc_macro2::LexError> {
    let mut text = String::new();
    append_tokens(&mut text, source.parse()?);
    Ok(text)
}

fn append_tokens(text: &mut String, stream: TokenStream) {
    let tokens: Vec<TokenTree> = stream.into_iter().collect();
    let mut at = 0;
    while at < tokens.len() {
        if let Some(end) = end_of_ignored(&tokens, at) {
            at = end;
            continue;
        }
        match &tokens[at] {
            TokenTree::Group(group) => {
                let (open, close) = match group.delimiter() {
                    Delimiter::Parenthesis => ("(", ")"),
                    Delimiter::Brace => ("{", "}"),
                    Delimiter::Bracket => ("[", "]"),
                    Delimiter::None => ("", ""),
                };
                text.push_str(open);
                append_tokens(text, group.stream());
                text.push_str(close);
            }
            TokenTree::Punct(punct) => {
                text.push(punct.as_char());
                // `&&` is not `& &`.
                text.push_str(if punct.spacing() == Spacing::Joint { "" } else { "\n" });
            }
            TokenTree::Ident(ident) => *text += &format!("{ident}\n"),
            TokenTree::Literal(literal) => *text += &format!("{literal}\n"),
        }
        at += 1;
    }
}

/// The end of the doc attribute or the test item at `at`, if there is one.
pub(super) fn end_of_ignored(tokens: &[TokenTree], at: usize) -> Option<usize> {
    let (end, attribute) = attribute(tokens, at)?;
    let compact = compact(attribute);
    let is_inner = is_punct(tokens.get(at + 1), '!');
    if compact.starts_with("doc=") {
        return Some(end);
    }
    (compact == "cfg(test)" && !is_inner).then(|| end_of_item(tokens, end)).flatten()
}

/// An attribute's content without white space, e.g. `cfg(test)`.
pub(super) fn compact(attribute: TokenStream) -> String {
    attribute.to_string().replace(char::is_whitespace, "")
}

/// The end and the content of the attribute (`#[…]` or `#![…]`) at `at`.
pub(super) fn attribute(tokens: &[TokenTree], at: usize) -> Option<(usize, TokenStream)> {
    if !is_punct(tokens.get(at), '#') {
        return None;
    }
    let open = at + 1 + usize::from(is_punct(tokens.get(at + 1), '!'));
    match tokens.get(open) {
        Some(TokenTree::Group(group)) if group.delimiter() == Delimiter::Bracket => Some((open + 1, group.stream())),
        _ => None,
    }
}

/// The end of the item at `at`; none for fields, match arms and statements, which therefore count.
fn end_of_item(tokens: &[TokenTree], mut at: usize) -> Option<usize> {
    while let Some((end, _)) = attribute(tokens, at) {
        at = end;
    }
    if is_ident(tokens.get(at), &["pub"]) {
        at += 1;
        let is_scope =
            |token: &TokenTree| matches!(token, TokenTree::Group(group) if group.delimiter() == Delimiter::Parenthesis);
        at += usize::from(tokens.get(at).is_some_and(is_scope));
    }
    let to_semicolon = is_ident(tokens.get(at), &["use", "static", "type", "extern"])
        || (is_ident(tokens.get(at), &["const"]) && !is_ident(tokens.get(at + 1), &["fn", "unsafe", "extern"]));
    let to_brace = ["mod", "fn", "impl", "struct", "enum", "trait", "unsafe", "const", "async", "macro_rules", "union"];
    if !to_semicolon && !is_ident(tokens.get(at), &to_brace) {
        return None;
    }
    let ends = |token: &TokenTree| match token {
        TokenTree::Group(group) => !to_semicolon && group.delimiter() == Delimiter::Brace,
        token => is_punct(Some(token), ';'),
    };
    tokens[at..].iter().position(ends).map(|length| at + length + 1)
}

pub(super) fn is_punct(token: Option<&TokenTree>, wanted: char) -> bool {
    matches!(token, Some(TokenTree::Punct(punct)) if punct.as_char() == wanted)
}

pub(super) fn is_ident(token: Option<&TokenTree>, wanted: &[&str]) -> bool {
    matches!(token, Some(TokenTree::Ident(ident)) if wanted.iter().any(|word| ident == word))
}

/// WGSL without comments, with every run of white space replaced by one space.
pub(crate) fn wgsl_tokens(source: &str) -> String {
    let mut code = String::new();
    let (mut rest, mut depth) = (source, 0);
    while let Some(c) = rest.chars().next() {
        let skip = if rest.starts_with("/*") {
            // WGSL comments nest.
            depth += 1;
            2
        } else if depth > 0 && rest.starts_with("*/") {
            depth -= 1;
            2
        } else if depth == 0 && rest.starts_with("//") {
            rest.find('\n').unwrap_or(rest.len())
        } else {
            code.push(if depth == 0 { c } else { ' ' });
            c.len_utf8()
        };
        // A comment separates words like a space.
        code.push_str(if skip > 1 && c == '/' { " " } else { "" });
        rest = &rest[skip..];
    }
    code.split_whitespace().collect::<Vec<_>>().join(" ")
}
