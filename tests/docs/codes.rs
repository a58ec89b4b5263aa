//! The codes of warnings, as the code writes them and as `docs/warnings.md` explains them.
//!
//! A code is the first argument of a constructor of [`WARNINGS`], or of a closure whose first parameter is called
//! `code` and which hands it on. Where it is no literal but a variable, the literals that the variable can be are
//! looked up in the same file: a `let`, a loop over tuples, or a function of the same folder that returns them. What
//! cannot be read in this way fails the test: nothing is passed over.

use crate::{pages, root};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use syn::spanned::Spanned as _;
use syn::visit::Visit;

/// Types whose first field and argument is a code.
const WARNINGS: [&str; 4] = ["Warning", "EstimateWarning", "Finding", "Remark"];

/// Every Rust file below `src` that is no test, parsed.
pub fn sources() -> Vec<(PathBuf, syn::File)> {
    let mut files = Vec::new();
    rust(&root().join("src"), &mut files);
    files.sort();
    files
        .into_iter()
        .map(|path| {
            let text = std::fs::read_to_string(&path).unwrap();
            let file = syn::parse_file(&text).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
            (path, file)
        })
        .collect()
}

fn rust(folder: &Path, into: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        if path.is_dir() && name != "tests" {
            rust(&path, into);
        } else if name.ends_with(".rs") && name != "tests.rs" {
            into.push(path);
        }
    }
}

fn is_test(attributes: &[syn::Attribute]) -> bool {
    attributes.iter().any(|a| {
        a.path().is_ident("test")
            || (a.path().is_ident("cfg") && a.parse_args::<syn::Ident>().is_ok_and(|i| i == "test"))
    })
}

/// The literal that an expression is.
fn literal(expression: &syn::Expr) -> Option<String> {
    match expression {
        syn::Expr::Lit(syn::ExprLit { lit: syn::Lit::Str(text), .. }) => Some(text.value()),
        syn::Expr::Paren(inner) => literal(&inner.expr),
        syn::Expr::MethodCall(call) if call.args.is_empty() && call.method != "clone" => literal(&call.receiver),
        _ => None,
    }
}

fn ident(expression: &syn::Expr) -> Option<String> {
    match expression {
        syn::Expr::Path(path) => path.path.get_ident().map(ToString::to_string),
        syn::Expr::Reference(inner) => ident(&inner.expr),
        syn::Expr::MethodCall(call) if call.args.is_empty() => ident(&call.receiver),
        _ => None,
    }
}

/// `Type::new`: the type's name.
fn constructed(call: &syn::ExprCall) -> Option<String> {
    let syn::Expr::Path(path) = &*call.func else { return None };
    let segments: Vec<String> = path.path.segments.iter().map(|s| s.ident.to_string()).collect();
    let [.., name, new] = segments.as_slice() else { return None };
    (new == "new").then(|| name.clone())
}

fn is_code(text: &str) -> bool {
    !text.is_empty() && text.chars().all(|c| c.is_ascii_lowercase() || c == '_') && !text.starts_with('_')
}

/// What a file says about codes.
#[derive(Default)]
struct Reader {
    /// Names of closures and functions whose first parameter is `code`.
    reporters: BTreeSet<String>,
    /// The expression that a code is written as, with its line.
    written: Vec<(usize, syn::Expr)>,
    /// Patterns and what they are bound to.
    bindings: Vec<(syn::Pat, syn::Expr)>,
    /// The type whose methods are being read.
    of: Option<String>,
}

impl Reader {
    fn write(&mut self, expression: &syn::Expr) {
        self.written.push((expression.span().start().line, expression.clone()));
    }
}

impl<'ast> Visit<'ast> for Reader {
    fn visit_item_mod(&mut self, item: &'ast syn::ItemMod) {
        if !is_test(&item.attrs) {
            syn::visit::visit_item_mod(self, item);
        }
    }

    fn visit_item_impl(&mut self, item: &'ast syn::ItemImpl) {
        let name = match &*item.self_ty {
            syn::Type::Path(path) => path.path.segments.last().map(|s| s.ident.to_string()),
            _ => None,
        };
        let before = std::mem::replace(&mut self.of, name);
        syn::visit::visit_item_impl(self, item);
        self.of = before;
    }

    fn visit_item_fn(&mut self, item: &'ast syn::ItemFn) {
        if let Some(syn::FnArg::Typed(first)) = item.sig.inputs.first()
            && takes_code(&syn::Pat::Type(first.clone()))
        {
            self.reporters.insert(item.sig.ident.to_string());
        }
        syn::visit::visit_item_fn(self, item);
    }

    fn visit_local(&mut self, local: &'ast syn::Local) {
        if let Some(init) = &local.init {
            if let (syn::Pat::Ident(name), syn::Expr::Closure(closure)) = (&local.pat, &*init.expr)
                && closure.inputs.first().is_some_and(takes_code)
            {
                self.reporters.insert(name.ident.to_string());
            }
            self.bindings.push((local.pat.clone(), (*init.expr).clone()));
        }
        syn::visit::visit_local(self, local);
    }

    fn visit_expr_for_loop(&mut self, item: &'ast syn::ExprForLoop) {
        self.bindings.push(((*item.pat).clone(), (*item.expr).clone()));
        syn::visit::visit_expr_for_loop(self, item);
    }

    fn visit_expr_call(&mut self, call: &'ast syn::ExprCall) {
        let is_own = |name: &str| name == "Self" && self.of.as_ref().is_some_and(|of| WARNINGS.contains(&of.as_str()));
        if constructed(call).is_some_and(|name| WARNINGS.contains(&name.as_str()) || is_own(&name))
            && let Some(first) = call.args.first()
        {
            self.write(first);
        }
        syn::visit::visit_expr_call(self, call);
    }

    fn visit_expr_struct(&mut self, item: &'ast syn::ExprStruct) {
        let name = item.path.segments.last().map(|s| s.ident.to_string()).unwrap_or_default();
        if WARNINGS.contains(&name.as_str()) {
            for field in item.fields.iter().filter(|f| matches!(&f.member, syn::Member::Named(n) if n == "code")) {
                self.write(&field.expr);
            }
        }
        syn::visit::visit_expr_struct(self, item);
    }
}

/// `Code` and its like: codes of problems.
fn is_problem_code(segment: Option<&syn::PathSegment>) -> bool {
    segment.is_some_and(|segment| segment.ident.to_string().ends_with("Code"))
}

/// A parameter `code` that takes a warning's code; that of a problem is of a type of its own.
fn takes_code(pattern: &syn::Pat) -> bool {
    let is_problem = |ty: &syn::Type| matches!(ty, syn::Type::Path(path) if is_problem_code(path.path.segments.last()));
    is_named(pattern, "code") && !matches!(pattern, syn::Pat::Type(typed) if is_problem(&typed.ty))
}

fn is_named(pattern: &syn::Pat, name: &str) -> bool {
    match pattern {
        syn::Pat::Ident(ident) => ident.ident == name,
        syn::Pat::Type(typed) => is_named(&typed.pat, name),
        _ => false,
    }
}

/// Calls of reporters.
struct Calls<'a> {
    reporters: &'a BTreeSet<String>,
    written: Vec<(usize, syn::Expr)>,
}

impl<'ast> Visit<'ast> for Calls<'_> {
    fn visit_item_mod(&mut self, item: &'ast syn::ItemMod) {
        if !is_test(&item.attrs) {
            syn::visit::visit_item_mod(self, item);
        }
    }

    fn visit_expr_call(&mut self, call: &'ast syn::ExprCall) {
        if ident(&call.func).is_some_and(|name| self.reporters.contains(&name))
            && let Some(first) = call.args.first()
        {
            self.written.push((first.span().start().line, first.clone()));
        }
        syn::visit::visit_expr_call(self, call);
    }
}

/// All string literals that look like a code.
#[derive(Default)]
struct Literals(BTreeSet<String>);

impl<'ast> Visit<'ast> for Literals {
    /// Comments are attributes with a literal.
    fn visit_attribute(&mut self, _: &'ast syn::Attribute) {}

    fn visit_lit_str(&mut self, text: &'ast syn::LitStr) {
        if is_code(&text.value()) {
            self.0.insert(text.value());
        }
    }
}

/// Names of functions that are called.
#[derive(Default)]
struct Called(BTreeSet<String>);

impl<'ast> Visit<'ast> for Called {
    fn visit_expr_call(&mut self, call: &'ast syn::ExprCall) {
        if let syn::Expr::Path(path) = &*call.func {
            self.0.extend(path.path.segments.last().map(|s| s.ident.to_string()));
        }
        syn::visit::visit_expr_call(self, call);
    }
}

/// The free functions of a folder, by name.
type Functions = BTreeMap<(PathBuf, String), syn::ItemFn>;

/// The literals in the functions that an expression calls, and in those that they call.
fn from_functions(folder: &Path, expression: &syn::Expr, functions: &Functions) -> BTreeSet<String> {
    let mut called = Called::default();
    called.visit_expr(expression);
    let mut open: Vec<String> = called.0.into_iter().collect();
    let mut seen = BTreeSet::new();
    let mut found = Literals::default();
    while let Some(name) = open.pop() {
        if let Some(function) = functions.get(&(folder.to_owned(), name.clone()))
            && seen.insert(name)
        {
            found.visit_item_fn(function);
            let mut more = Called::default();
            more.visit_item_fn(function);
            open.extend(more.0);
        }
    }
    found.0
}

/// The position of a name in a pattern of a tuple; 0 where the pattern is the name.
fn position(pattern: &syn::Pat, name: &str) -> Option<usize> {
    match pattern {
        syn::Pat::Tuple(tuple) => tuple.elems.iter().position(|part| is_named(part, name)),
        single => is_named(single, name).then_some(0),
    }
}

/// The literals that stand at this position in an expression: of each tuple of an array, or of each arm.
fn at_position(expression: &syn::Expr, position: usize, into: &mut BTreeSet<String>) {
    match expression {
        syn::Expr::Array(array) => array.elems.iter().for_each(|e| at_position(e, position, into)),
        syn::Expr::Tuple(tuple) => {
            if let Some(part) = tuple.elems.get(position) {
                at_position(part, 0, into);
            }
        }
        syn::Expr::If(item) => {
            at_block(&item.then_branch, position, into);
            if let Some((_, other)) = &item.else_branch {
                at_position(other, position, into);
            }
        }
        syn::Expr::Match(item) => item.arms.iter().for_each(|arm| at_position(&arm.body, position, into)),
        syn::Expr::Block(block) => at_block(&block.block, position, into),
        other => into.extend(literal(other)),
    }
}

fn at_block(block: &syn::Block, position: usize, into: &mut BTreeSet<String>) {
    if let Some(syn::Stmt::Expr(last, None)) = block.stmts.last() {
        at_position(last, position, into);
    }
}

/// The codes in `src`, each with the places that write it.
fn in_code() -> BTreeMap<String, BTreeSet<String>> {
    let sources = sources();
    let mut functions = Functions::new();
    for (path, file) in &sources {
        for item in &file.items {
            if let syn::Item::Fn(function) = item {
                let folder = path.parent().unwrap().to_owned();
                functions.insert((folder, function.sig.ident.to_string()), function.clone());
            }
        }
    }
    let mut codes: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    let mut unread = Vec::new();
    for (path, file) in &sources {
        let mut reader = Reader::default();
        reader.visit_file(file);
        let mut calls = Calls { reporters: &reader.reporters, written: Vec::new() };
        calls.visit_file(file);
        let folder = path.parent().unwrap();
        let name = path.strip_prefix(root()).unwrap().display().to_string();
        for (line, expression) in reader.written.iter().chain(&calls.written) {
            let place = format!("{name}:{line}");
            let mut found = BTreeSet::new();
            let is_handed_on = match expression {
                // `finding.code`: written where the finding was made.
                syn::Expr::Field(field) => matches!(&field.member, syn::Member::Named(n) if n == "code"),
                // `Code::Invalid`: the code of a problem.
                syn::Expr::Path(path) => path.path.segments.len() == 2 && is_problem_code(path.path.segments.first()),
                _ => false,
            };
            if let Some(code) = literal(expression) {
                found.insert(code);
            } else if let Some(variable) = ident(expression) {
                for (pattern, bound) in &reader.bindings {
                    if let Some(position) = position(pattern, &variable) {
                        at_position(bound, position, &mut found);
                        if found.is_empty() {
                            found.extend(from_functions(folder, bound, &functions));
                        }
                    }
                }
                // The parameter of a reporter: written where it is called.
                if found.is_empty() && variable == "code" && has_reporter_at(file, *line) {
                    continue;
                }
            } else if is_handed_on {
                continue;
            }
            if found.is_empty() {
                unread.push(place.clone());
            }
            for code in found {
                codes.entry(code).or_default().insert(place.clone());
            }
        }
    }
    assert!(unread.is_empty(), "which code is written here? {unread:?}");
    codes
}

/// Whether a line lies in a function or closure whose first parameter (but for `self`) is `code`.
fn has_reporter_at(file: &syn::File, line: usize) -> bool {
    struct Around(usize, bool);
    impl Around {
        fn look(&mut self, span: proc_macro2::Span, is_reporter: bool) {
            self.1 |= is_reporter && (span.start().line..=span.end().line).contains(&self.0);
        }
    }
    fn first_is_code(signature: &syn::Signature) -> bool {
        let first = signature.inputs.iter().find_map(|input| match input {
            syn::FnArg::Typed(typed) => Some(syn::Pat::Type(typed.clone())),
            syn::FnArg::Receiver(_) => None,
        });
        first.is_some_and(|pattern| takes_code(&pattern))
    }
    impl<'ast> Visit<'ast> for Around {
        fn visit_expr_closure(&mut self, item: &'ast syn::ExprClosure) {
            self.look(item.span(), item.inputs.first().is_some_and(takes_code));
            syn::visit::visit_expr_closure(self, item);
        }
        fn visit_item_fn(&mut self, item: &'ast syn::ItemFn) {
            self.look(item.span(), first_is_code(&item.sig));
            syn::visit::visit_item_fn(self, item);
        }
        fn visit_impl_item_fn(&mut self, item: &'ast syn::ImplItemFn) {
            self.look(item.span(), first_is_code(&item.sig));
            syn::visit::visit_impl_item_fn(self, item);
        }
    }
    let mut around = Around(line, false);
    around.visit_file(file);
    around.1
}

/// The entries of `docs/warnings.md`: code and text.
fn in_docs() -> BTreeMap<String, String> {
    let page = pages().into_iter().find(|page| page.name == "docs/warnings.md").unwrap();
    let mut entries = BTreeMap::new();
    let mut current: Option<(String, String)> = None;
    for line in page.text.lines() {
        if line.starts_with('#') {
            entries.extend(current.take());
        }
        if let Some(code) = line.strip_prefix("### `").and_then(|rest| rest.strip_suffix('`')) {
            assert!(!entries.contains_key(code), "docs/warnings.md explains {code} twice");
            current = Some((code.to_owned(), String::new()));
        } else if let Some((_, text)) = &mut current {
            text.push_str(line);
            text.push('\n');
        }
    }
    entries.extend(current);
    entries
}

#[test]
fn every_warning_is_explained_and_none_that_is_gone() {
    let (code, docs) = (in_code(), in_docs());
    assert!(code.len() > 90, "only {} codes were found: the test no longer reads the code", code.len());
    let missing: Vec<_> = code.iter().filter(|(code, _)| !docs.contains_key(*code)).collect();
    assert!(missing.is_empty(), "docs/warnings.md does not explain {missing:#?}");
    let gone: Vec<_> = docs.keys().filter(|known| !code.contains_key(*known)).collect();
    assert!(gone.is_empty(), "docs/warnings.md explains {gone:?}, which nothing writes");
    for (code, text) in docs {
        let paragraphs: Vec<&str> = text.split("\n\n").map(str::trim).filter(|p| !p.is_empty()).collect();
        let [meaning, advice] = paragraphs.as_slice() else {
            panic!("{code} has {} paragraphs: one for its meaning, one for what to do", paragraphs.len())
        };
        assert!(meaning.len() > 20 && !meaning.starts_with("Do"), "{code} does not say what it means");
        assert!(advice.starts_with("Do: ") || advice.starts_with("Do not "), "{code} does not say what to do");
    }
}
