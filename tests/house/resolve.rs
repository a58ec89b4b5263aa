//! Where a path leads: to the module that defines it, through re-exports.

use crate::source::{Mention, Sources};

/// What a path names.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Target {
    /// A module.
    Module(usize),
    /// Something that this module defines. What its macros define is counted as its own.
    Item(usize),
}

impl Target {
    pub fn module(self) -> usize {
        match self {
            Self::Module(module) | Self::Item(module) => module,
        }
    }
}

impl Sources {
    /// Everything that a path may name, seen from a module: nothing when it leads out of the crate, more than one when
    /// several name spaces have the word. The part of a path behind a type (a variant, a method) is not looked at.
    pub fn resolve(&self, from: usize, path: &[String]) -> Vec<Target> {
        self.follow(from, path, true, &mut Vec::new())
    }

    /// Where a mention leads. A macro that is in scope by its place in the text (`#[macro_use]`, `#[macro_export]`) is
    /// found by its name.
    pub fn mentioned(&self, from: usize, mention: &Mention) -> Vec<Target> {
        let found = self.follow(from, &mention.path, !mention.guessed, &mut Vec::new());
        if !mention.calls_macro || found.iter().any(|target| *target != Target::Item(0)) {
            return found;
        }
        let name = mention.path.last().map_or("", String::as_str);
        let makers = (0..self.modules.len()).filter(|module| self.modules[*module].macros.contains_key(name));
        makers.map(Target::Item).collect()
    }

    /// `macros_define`: what a module does not show is made by its macros.
    fn follow(
        &self,
        from: usize,
        path: &[String],
        macros_define: bool,
        seen: &mut Vec<(usize, String)>,
    ) -> Vec<Target> {
        let Some((first, rest)) = path.split_first() else { return Vec::new() };
        let mut rest = rest;
        let mut reached = match first.as_str() {
            "crate" => vec![Target::Module(0)],
            "self" => vec![Target::Module(from)],
            "super" => self.modules[from].parent.map(Target::Module).into_iter().collect(),
            _ => self.named(from, first, seen),
        };
        while let Some((word, left)) = rest.split_first() {
            let mut next = Vec::new();
            for target in reached {
                match target {
                    Target::Item(_) => next.push(target),
                    Target::Module(module) if word == "super" => {
                        next.extend(self.modules[module].parent.map(Target::Module));
                    }
                    Target::Module(module) if word == "self" => next.push(Target::Module(module)),
                    Target::Module(module) => {
                        let found = self.named(module, word, seen);
                        if found.is_empty() && macros_define && !self.leads_out(module, word) {
                            next.push(Target::Item(module));
                        }
                        next.extend(found);
                    }
                }
            }
            next.dedup();
            reached = next;
            rest = left;
        }
        reached
    }

    /// Whether a name comes from another crate by an import of a module.
    fn leads_out(&self, module: usize, name: &str) -> bool {
        self.modules[module].imports.iter().any(|import| import.name.as_deref() == Some(name))
    }

    /// What a word names in a module: its children and items, what it imports by name, what it imports by globs.
    fn named(&self, module: usize, name: &str, seen: &mut Vec<(usize, String)>) -> Vec<Target> {
        let here = &self.modules[module];
        let mut found: Vec<Target> = here.children.get(name).map(|child| Target::Module(*child)).into_iter().collect();
        if here.items.contains(name) {
            found.push(Target::Item(module));
        }
        let key = (module, name.to_owned());
        if seen.contains(&key) {
            return found;
        }
        seen.push(key);
        for import in here.imports.iter().filter(|import| import.name.as_deref() == Some(name)) {
            found.extend(self.follow(module, &import.path, true, seen));
        }
        if found.is_empty() {
            for import in here.imports.iter().filter(|import| import.name.is_none()) {
                for target in self.follow(module, &import.path, true, seen) {
                    if let Target::Module(brought) = target {
                        found.extend(self.named(brought, name, seen));
                    }
                }
            }
        }
        seen.pop();
        found.dedup();
        found
    }
}
