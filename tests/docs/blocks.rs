//! The fenced blocks of a page.

use crate::Page;
use pulldown_cmark::{CodeBlockKind, Event, Parser, Tag, TagEnd};

/// What a block is, as its info string says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum What {
    /// `sh`: commands of bash, executed one block after another in one folder; what one block sets, the next ones see.
    Commands,
    /// `sh server`: one command that starts a server, which runs until the end of the page.
    Server,
    /// `json`: a request, executed by `volition run`.
    Request,
    /// `json result`: an answer, or a part of a document. It must be JSON.
    Json,
    /// `text output`: lines that the blocks of commands before it print, among others.
    Output,
    /// `text`: formulas, drawings, lists. Nothing to execute.
    Text,
    /// `python`, `r`, `matlab`: all such blocks of a page are one program, executed where the language is installed.
    Program(Language),
}

/// A language of recipes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Language {
    Python,
    R,
    Matlab,
}

impl What {
    /// `None` for an info string that nobody knows.
    fn of(info: &str) -> Option<Self> {
        Some(match info {
            "sh" => Self::Commands,
            "sh server" => Self::Server,
            "json" => Self::Request,
            "json result" => Self::Json,
            "text output" => Self::Output,
            "text" => Self::Text,
            "python" => Self::Program(Language::Python),
            "r" => Self::Program(Language::R),
            "matlab" => Self::Program(Language::Matlab),
            _ => return None,
        })
    }
}

/// A block, and the line of the page that it begins in.
#[derive(Debug, Clone)]
pub struct Block {
    pub what: What,
    pub line: usize,
    pub text: String,
}

/// The blocks of a page in their order.
///
/// # Panics
/// Where one is unmarked, or marked with something that nobody knows.
pub fn blocks(page: &Page) -> Vec<Block> {
    let mut found = Vec::new();
    let mut open: Option<Block> = None;
    for (event, range) in Parser::new(&page.text).into_offset_iter() {
        let line = 1 + page.text[..range.start].matches('\n').count();
        match event {
            Event::Start(Tag::CodeBlock(CodeBlockKind::Fenced(info))) => {
                let what = What::of(info.trim()).unwrap_or_else(|| {
                    panic!(
                        "{}:{line}: the block is marked '{info}'; the marks are listed in tests/docs/blocks.rs",
                        page.name
                    )
                });
                open = Some(Block { what, line, text: String::new() });
            }
            Event::Start(Tag::CodeBlock(CodeBlockKind::Indented)) => {
                panic!("{}:{line}: an indented block does not say what it is; fence it", page.name)
            }
            Event::Text(text) => {
                if let Some(block) = &mut open {
                    block.text.push_str(&text);
                }
            }
            Event::End(TagEnd::CodeBlock) => found.extend(open.take()),
            _ => {}
        }
    }
    found
}
