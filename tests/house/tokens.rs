//! What stands in the tokens of macros, where `syn` sees no code.

use proc_macro2::{TokenStream, TokenTree};

/// A path in tokens; `None` where a macro has a variable.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TokenPath {
    pub words: Vec<Option<String>>,
    /// Whether an exclamation mark follows.
    pub calls_macro: bool,
    pub line: usize,
}

/// Everything found in a stream of tokens, groups within it included.
#[derive(Debug, Default)]
pub struct Found {
    /// Words that follow no dot, with all that follows them by `::`; paths in quotes too, as in
    /// `#[serde(with = "room::module")]`.
    pub paths: Vec<TokenPath>,
    /// The types of statics, each with its line.
    pub statics: Vec<(String, usize)>,
}

/// Looks through tokens.
pub fn scan(tokens: TokenStream) -> Found {
    let mut found = Found::default();
    found.stream(tokens);
    found
}

fn is_punct(token: Option<&TokenTree>, sign: char) -> bool {
    matches!(token, Some(TokenTree::Punct(punct)) if punct.as_char() == sign)
}

impl Found {
    fn stream(&mut self, tokens: TokenStream) {
        let tokens: Vec<TokenTree> = tokens.into_iter().collect();
        let mut at = 0;
        while at < tokens.len() {
            match &tokens[at] {
                TokenTree::Group(group) => self.stream(group.stream()),
                TokenTree::Literal(literal) => self.quoted(&literal.to_string(), literal.span().start().line),
                TokenTree::Ident(word) if word == "static" && !is_punct(before(&tokens, at, 1), '\'') => {
                    let until_value = tokens[at + 1..].iter().take_while(|token| !is_punct(Some(token), '='));
                    let declared = until_value.map(ToString::to_string).collect::<Vec<_>>().join(" ");
                    self.statics.push((declared, word.span().start().line));
                }
                TokenTree::Ident(word) => {
                    let after_dot = is_punct(before(&tokens, at, 1), '.') && !is_punct(before(&tokens, at, 2), '.');
                    let line = word.span().start().line;
                    let variable = is_punct(before(&tokens, at, 1), '$') && word != "crate";
                    let mut words = vec![(!variable).then(|| word.to_string())];
                    while is_punct(tokens.get(at + 1), ':') && is_punct(tokens.get(at + 2), ':') {
                        match (tokens.get(at + 3), tokens.get(at + 4)) {
                            (Some(TokenTree::Ident(next)), _) => {
                                words.push(Some(next.to_string()));
                                at += 3;
                            }
                            (sign, Some(TokenTree::Ident(_))) if is_punct(sign, '$') => {
                                words.push(None);
                                at += 4;
                            }
                            _ => break,
                        }
                    }
                    if !after_dot {
                        self.paths.push(TokenPath { words, calls_macro: is_punct(tokens.get(at + 1), '!'), line });
                    }
                }
                TokenTree::Punct(_) => {}
            }
            at += 1;
        }
    }

    fn quoted(&mut self, literal: &str, line: usize) {
        let Some(text) = literal.strip_prefix('"').and_then(|text| text.strip_suffix('"')) else { return };
        let words: Vec<&str> = text.split("::").collect();
        let is_word = |word: &&str| !word.is_empty() && word.chars().all(|c| c.is_alphanumeric() || c == '_');
        if words.len() > 1 && words.iter().all(is_word) {
            let words = words.into_iter().map(|word| Some(word.to_owned())).collect();
            self.paths.push(TokenPath { words, calls_macro: false, line });
        }
    }
}

fn before(tokens: &[TokenTree], at: usize, back: usize) -> Option<&TokenTree> {
    at.checked_sub(back).map(|at| &tokens[at])
}
