//! The library as a tree of modules, each with what it defines, imports and mentions, read with `syn`.

use crate::tokens::{self, TokenPath};
use proc_macro2::TokenStream;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use syn::spanned::Spanned;
use syn::visit::{self, Visit};
use syn::{Attribute, Item, UseTree, Visibility};

/// Who may see what a `use` brings in.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Reach {
    /// The module and its children.
    Private,
    /// `pub(super)` or `pub(in ..)`: somewhere in between.
    Some,
    /// `pub` or `pub(crate)`: every room.
    Crate,
}

/// One leaf of a `use`, or an alias (`type Name = path;`).
#[derive(Debug, Clone)]
pub struct Import {
    /// The name that it has here; `None` for a glob.
    pub name: Option<String>,
    pub path: Vec<String>,
    pub reach: Reach,
    pub test: bool,
    pub line: usize,
}

/// A path in the code, of at least one word.
#[derive(Debug, Clone)]
pub struct Mention {
    pub path: Vec<String>,
    /// Whether an exclamation mark follows.
    pub calls_macro: bool,
    /// Whether it was put together from a macro and what it is called with, and may name nothing.
    pub guessed: bool,
    pub test: bool,
    pub line: usize,
}

/// A call of a macro: the words that it is called with.
#[derive(Debug)]
pub struct Call {
    pub name: String,
    pub words: Vec<String>,
    pub test: bool,
    pub line: usize,
}

/// A module, in a file of its own or in braces.
#[derive(Debug, Default)]
pub struct Module {
    /// Its path from the crate's root, which has none.
    pub path: Vec<String>,
    pub parent: Option<usize>,
    /// The index of its file in [`Sources::files`].
    pub file: usize,
    /// The names of what it defines, in whichever name space.
    pub items: BTreeSet<String>,
    /// Those of them that are macros, and macros within its functions, with the paths in them that have variables.
    pub macros: BTreeMap<String, Vec<Vec<Option<String>>>>,
    pub calls: Vec<Call>,
    pub children: BTreeMap<String, usize>,
    pub imports: Vec<Import>,
    pub aliases: Vec<Import>,
    pub mentions: Vec<Mention>,
}

/// One file of the library.
#[derive(Debug)]
pub struct SourceFile {
    /// Relative to `src`.
    pub path: PathBuf,
    /// The path of its module.
    pub module: Vec<String>,
    /// Whether all of it is compiled for tests only.
    pub test: bool,
    pub text: String,
    /// Lines with unsafe code, or which allow it.
    pub unsafe_lines: Vec<usize>,
    /// Types of statics, with their lines.
    pub statics: Vec<(String, usize)>,
}

impl SourceFile {
    /// The room: the first word of its path; the crate's roots have none.
    pub fn room(&self) -> Option<&str> {
        self.module.first().map(String::as_str)
    }
}

/// The library.
#[derive(Debug, Default)]
pub struct Sources {
    pub files: Vec<SourceFile>,
    pub modules: Vec<Module>,
}

impl Sources {
    /// Reads `src/lib.rs` and every file that it reaches by `mod`.
    ///
    /// # Panics
    /// When a file cannot be read or parsed, when a module has its file elsewhere (`#[path]`), or when a file of `src`
    /// belongs to no module: such code would escape the checks.
    pub fn read(project: &Path) -> Self {
        let root = project.join("src");
        let mut sources = Self::default();
        sources.file(&root, Path::new("lib.rs"), &[], None, false);
        sources.expand();
        let known: BTreeSet<_> = sources.files.iter().map(|file| root.join(&file.path)).collect();
        for path in rust_files(&root) {
            assert!(known.contains(&path) || path == root.join("main.rs"), "{} is in no module", path.display());
        }
        sources
    }

    /// What the paths of macros become where they are called: `super::$kind::Plan` with `ssid` is `super::ssid::Plan`.
    fn expand(&mut self) {
        let mut patterns: BTreeMap<String, Vec<Vec<Option<String>>>> = BTreeMap::new();
        for (name, paths) in self.modules.iter().flat_map(|module| &module.macros) {
            patterns.entry(name.clone()).or_default().extend(paths.iter().cloned());
        }
        for module in &mut self.modules {
            for call in &module.calls {
                for pattern in patterns.get(&call.name).into_iter().flatten() {
                    for word in &call.words {
                        let path = pattern.iter().map(|part| part.clone().unwrap_or_else(|| word.clone())).collect();
                        let (test, line) = (call.test, call.line);
                        module.mentions.push(Mention { path, calls_macro: false, guessed: true, test, line });
                    }
                }
            }
        }
    }

    fn file(&mut self, root: &Path, path: &Path, module: &[String], parent: Option<usize>, test: bool) -> usize {
        let text = fs::read_to_string(root.join(path)).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        let syntax = syn::parse_file(&text).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        let test = test || for_tests(&syntax.attrs);
        let file = self.files.len();
        self.files.push(SourceFile {
            path: path.to_owned(),
            module: module.to_vec(),
            test,
            text,
            unsafe_lines: Vec::new(),
            statics: Vec::new(),
        });
        let index = self.module(module, parent, file);
        Reader { sources: self, root, module: index, test, depth: 0, defining: None }.visit_file(&syntax);
        index
    }

    fn module(&mut self, path: &[String], parent: Option<usize>, file: usize) -> usize {
        let index = self.modules.len();
        self.modules.push(Module { path: path.to_vec(), parent, file, ..Module::default() });
        if let (Some(parent), Some(name)) = (parent, path.last()) {
            self.modules[parent].children.insert(name.clone(), index);
        }
        index
    }
}

/// Every Rust file below a folder, in order.
pub fn rust_files(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let entries = fs::read_dir(folder).unwrap_or_else(|e| panic!("{}: {e}", folder.display()));
    let mut entries: Vec<_> = entries.map(|entry| entry.unwrap().path()).collect();
    entries.sort();
    for path in entries {
        if path.is_dir() && !path.ends_with("target") {
            found.extend(rust_files(&path));
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            found.push(path);
        }
    }
    found
}

/// Whether `#[cfg(test)]` or `#[test]` stands above it.
fn for_tests(attributes: &[Attribute]) -> bool {
    attributes.iter().any(|attribute| {
        let path = attribute.path();
        let conditions = || attribute.meta.require_list().map(|list| list.tokens.to_string()).unwrap_or_default();
        path.is_ident("test")
            || path.segments.last().is_some_and(|last| last.ident == "test")
            || (path.is_ident("cfg") && {
                let conditions = conditions();
                words(&conditions).any(|word| word == "test") && !words(&conditions).any(|word| word == "not")
            })
    })
}

fn words(text: &str) -> impl Iterator<Item = &str> {
    text.split(|c: char| !c.is_alphanumeric() && c != '_')
}

fn attributes(item: &Item) -> &[Attribute] {
    match item {
        Item::Const(item) => &item.attrs,
        Item::Enum(item) => &item.attrs,
        Item::Fn(item) => &item.attrs,
        Item::Impl(item) => &item.attrs,
        Item::Macro(item) => &item.attrs,
        Item::Mod(item) => &item.attrs,
        Item::Static(item) => &item.attrs,
        Item::Struct(item) => &item.attrs,
        Item::Trait(item) => &item.attrs,
        Item::Type(item) => &item.attrs,
        Item::Union(item) => &item.attrs,
        Item::Use(item) => &item.attrs,
        _ => &[],
    }
}

struct Reader<'a> {
    sources: &'a mut Sources,
    root: &'a Path,
    module: usize,
    test: bool,
    /// How many functions and blocks are around.
    depth: usize,
    /// The macro that is being read.
    defining: Option<String>,
}

impl Reader<'_> {
    fn here(&mut self) -> &mut Module {
        &mut self.sources.modules[self.module]
    }

    fn source(&mut self) -> &mut SourceFile {
        let file = self.here().file;
        &mut self.sources.files[file]
    }

    fn mention(&mut self, path: Vec<String>, calls_macro: bool, line: usize) {
        let test = self.test;
        self.here().mentions.push(Mention { path, calls_macro, guessed: false, test, line });
    }

    fn import(&mut self, tree: &UseTree, before: &mut Vec<String>, reach: Reach) {
        let line = tree.span().start().line;
        let test = self.test;
        let mut leaf = |path: Vec<String>, name: Option<String>| {
            self.here().imports.push(Import { name, path, reach, test, line });
        };
        match tree {
            UseTree::Path(part) => {
                before.push(part.ident.to_string());
                self.import(&part.tree, before, reach);
                before.pop();
            }
            UseTree::Group(group) => {
                for tree in &group.items {
                    self.import(tree, before, reach);
                }
            }
            UseTree::Name(name) if name.ident == "self" => leaf(before.clone(), before.last().cloned()),
            UseTree::Name(name) => {
                let name = name.ident.to_string();
                leaf([before.as_slice(), std::slice::from_ref(&name)].concat(), Some(name));
            }
            UseTree::Rename(renamed) if renamed.ident == "self" => {
                leaf(before.clone(), Some(renamed.rename.to_string()));
            }
            UseTree::Rename(renamed) => {
                leaf([before.as_slice(), &[renamed.ident.to_string()]].concat(), Some(renamed.rename.to_string()));
            }
            UseTree::Glob(_) => leaf(before.clone(), None),
        }
    }

    /// The file of `mod name;`.
    fn child_file(&self, name: &str) -> PathBuf {
        let module = &self.sources.modules[self.module].path;
        let folder: PathBuf = module.iter().collect();
        let candidates = [folder.join(format!("{name}.rs")), folder.join(name).join("mod.rs")];
        let found = candidates.iter().find(|candidate| self.root.join(candidate).is_file());
        found.unwrap_or_else(|| panic!("mod {name} of {module:?} has no file")).clone()
    }

    /// What tokens mention; paths with variables belong to the macro that is being defined.
    fn tokens(&mut self, tokens: TokenStream) {
        let found = tokens::scan(tokens);
        self.source().statics.extend(found.statics);
        for TokenPath { words, calls_macro, line } in found.paths {
            if words.iter().all(Option::is_some) {
                self.mention(words.into_iter().flatten().collect(), calls_macro, line);
            } else if let Some(name) = self.defining.clone() {
                self.here().macros.entry(name).or_default().push(words);
            }
        }
    }

    fn define(&mut self, name: &syn::Ident) {
        if self.depth == 0 {
            self.here().items.insert(name.to_string());
        }
    }

    fn unsafe_at(&mut self, line: usize) {
        self.source().unsafe_lines.push(line);
    }
}

fn in_words(path: &syn::Path) -> Vec<String> {
    path.segments.iter().map(|segment| segment.ident.to_string()).collect()
}

/// The words of a static's type, `mut` included.
fn type_text(item: &syn::ItemStatic) -> String {
    struct Words(Vec<String>);
    impl<'ast> Visit<'ast> for Words {
        fn visit_path(&mut self, path: &'ast syn::Path) {
            self.0.extend(in_words(path));
            visit::visit_path(self, path);
        }
    }
    let mut found = Words(Vec::new());
    found.visit_type(&item.ty);
    if matches!(item.mutability, syn::StaticMutability::Mut(_)) {
        found.0.push("mut".to_owned());
    }
    found.0.join(" ")
}

fn reach(visibility: &Visibility) -> Reach {
    match visibility {
        Visibility::Public(_) => Reach::Crate,
        Visibility::Inherited => Reach::Private,
        Visibility::Restricted(restricted) if restricted.path.is_ident("crate") => Reach::Crate,
        Visibility::Restricted(restricted) if restricted.path.is_ident("self") => Reach::Private,
        Visibility::Restricted(_) => Reach::Some,
    }
}

impl<'ast> Visit<'ast> for Reader<'_> {
    fn visit_item(&mut self, item: &'ast Item) {
        let outer = self.test;
        self.test |= for_tests(attributes(item));
        match item {
            Item::Const(item) => self.define(&item.ident),
            Item::Enum(item) => self.define(&item.ident),
            Item::Fn(item) => self.define(&item.sig.ident),
            Item::Static(item) => {
                self.define(&item.ident);
                let declared = (type_text(item), item.span().start().line);
                self.source().statics.push(declared);
            }
            Item::Struct(item) => self.define(&item.ident),
            Item::Trait(item) => self.define(&item.ident),
            Item::Type(item) => {
                self.define(&item.ident);
                if let syn::Type::Path(target) = &*item.ty
                    && target.path.segments.iter().all(|segment| segment.arguments.is_none())
                {
                    let path = in_words(&target.path);
                    let (name, line) = (Some(item.ident.to_string()), item.span().start().line);
                    let alias = Import { name, path, reach: reach(&item.vis), test: self.test, line };
                    self.here().aliases.push(alias);
                }
            }
            Item::Union(item) => self.define(&item.ident),
            Item::Macro(item) => {
                if let Some(name) = &item.ident {
                    self.define(name);
                    self.here().macros.entry(name.to_string()).or_default();
                }
            }
            Item::ForeignMod(item) => self.unsafe_at(item.span().start().line),
            _ => {}
        }
        visit::visit_item(self, item);
        self.test = outer;
    }

    fn visit_item_mod(&mut self, item: &'ast syn::ItemMod) {
        for attribute in &item.attrs {
            assert!(!attribute.path().is_ident("path"), "mod {} has its file elsewhere", item.ident);
            self.visit_attribute(attribute);
        }
        let path = [self.here().path.as_slice(), &[item.ident.to_string()]].concat();
        let parent = Some(self.module);
        if let Some((_, items)) = &item.content {
            let file = self.here().file;
            let module = self.sources.module(&path, parent, file);
            let mut inner =
                Reader { sources: self.sources, root: self.root, module, test: self.test, depth: 0, defining: None };
            for item in items {
                inner.visit_item(item);
            }
        } else {
            let file = self.child_file(&item.ident.to_string());
            self.sources.file(self.root, &file, &path, parent, self.test);
        }
    }

    fn visit_item_use(&mut self, item: &'ast syn::ItemUse) {
        // What a function imports for itself leads out of it as little as what its module imports.
        self.import(&item.tree, &mut Vec::new(), reach(&item.vis));
    }

    fn visit_block(&mut self, block: &'ast syn::Block) {
        self.depth += 1;
        visit::visit_block(self, block);
        self.depth -= 1;
    }

    fn visit_impl_item_fn(&mut self, item: &'ast syn::ImplItemFn) {
        let outer = self.test;
        self.test |= for_tests(&item.attrs);
        visit::visit_impl_item_fn(self, item);
        self.test = outer;
    }

    fn visit_path(&mut self, path: &'ast syn::Path) {
        self.mention(in_words(path), false, path.span().start().line);
        visit::visit_path(self, path);
    }

    fn visit_item_macro(&mut self, item: &'ast syn::ItemMacro) {
        let outer = self.defining.clone();
        self.defining = item.ident.as_ref().map(ToString::to_string).or(outer.clone());
        visit::visit_item_macro(self, item);
        self.defining = outer;
    }

    fn visit_vis_restricted(&mut self, _: &'ast syn::VisRestricted) {}

    fn visit_macro(&mut self, called: &'ast syn::Macro) {
        let path = in_words(&called.path);
        let line = called.path.span().start().line;
        if let Some(name) = path.last().filter(|_| self.defining.is_none()) {
            let paths = tokens::scan(called.tokens.clone()).paths.into_iter();
            let words = paths.filter_map(|path| path.words.into_iter().next().flatten()).collect();
            let call = Call { name: name.clone(), words, test: self.test, line };
            self.here().calls.push(call);
        }
        self.mention(path, true, line);
        self.tokens(called.tokens.clone());
    }

    fn visit_attribute(&mut self, attribute: &'ast Attribute) {
        if attribute.path().is_ident("doc") {
            return;
        }
        if let syn::Meta::List(list) = &attribute.meta {
            if list.path.is_ident("allow") && words(&list.tokens.to_string()).any(|word| word == "unsafe_code") {
                self.unsafe_at(attribute.span().start().line);
            }
            self.tokens(list.tokens.clone());
        }
    }

    fn visit_expr_unsafe(&mut self, block: &'ast syn::ExprUnsafe) {
        self.unsafe_at(block.span().start().line);
        visit::visit_expr_unsafe(self, block);
    }

    fn visit_signature(&mut self, signature: &'ast syn::Signature) {
        if signature.unsafety.is_some() {
            self.unsafe_at(signature.span().start().line);
        }
        visit::visit_signature(self, signature);
    }

    fn visit_item_impl(&mut self, item: &'ast syn::ItemImpl) {
        if item.unsafety.is_some() {
            self.unsafe_at(item.span().start().line);
        }
        visit::visit_item_impl(self, item);
    }
}
