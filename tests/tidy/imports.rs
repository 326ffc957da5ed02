//! Finds which files of a crate name each other, judging by their paths: `crate::a::b`, `super::a`, and groups of them.

use std::collections::{BTreeMap, BTreeSet};

use super::source::{Source, sources};

/// A module's path within its crate.
type Module = Vec<String>;

/// Lists pairs of files that name each other, except a module and one inside it: a module may know its parts, and its
/// parts may know it.
pub(crate) fn circles() -> Vec<String> {
    let sources = sources();
    let mut crates: BTreeMap<&str, BTreeMap<Module, &Source>> = BTreeMap::new();
    for source in &sources {
        if let Some((root, file)) = source.path.split_once("/src/") {
            crates.entry(root).or_default().insert(module(file), source);
        }
    }
    let mut circles = Vec::new();
    for (root, files) in crates {
        let named: BTreeMap<_, _> =
            files.iter().map(|(own, source)| (own, named_by(own, source, &files))).collect();
        for (one, others) in &named {
            for other in others.iter().filter(|other| one < other && !other.starts_with(one)) {
                if named[other].contains(*one) {
                    circles.push(format!("{root}: {} and {}", one.join("::"), other.join("::")));
                }
            }
        }
    }
    circles
}

/// Returns the module of a file: `a/b.rs` and `a/b/mod.rs` are `a::b`.
fn module(file: &str) -> Module {
    let mut parts: Module = file.trim_end_matches(".rs").split('/').map(str::to_owned).collect();
    parts.pop_if(|last| ["mod", "lib", "main"].contains(&last.as_str()));
    parts
}

fn named_by(own: &Module, source: &Source, files: &BTreeMap<Module, &Source>) -> BTreeSet<Module> {
    let code = source.code.split("#[cfg(test)]").next().unwrap_or_default();
    let mut named = BTreeSet::new();
    for start in ["crate::", "super::", "self::"] {
        for (at, _) in code.match_indices(start) {
            if code[..at]
                .ends_with(|letter: char| letter.is_alphanumeric() || "_:".contains(letter))
            {
                continue;
            }
            named.extend(paths(&code[at..]).into_iter().map(|path| resolved(own, &path, files)));
        }
    }
    named.remove(own);
    named
}

/// Returns the paths that begin here; several for a group in braces.
fn paths(code: &str) -> Vec<Vec<String>> {
    let is_of_path = |letter: char| letter.is_alphanumeric() || "_:".contains(letter);
    let end = code.find(|letter| !is_of_path(letter)).unwrap_or(code.len());
    let head: Vec<String> =
        code[..end].split("::").filter(|part| !part.is_empty()).map(str::to_owned).collect();
    let Some(group) = code[end..].strip_prefix('{').filter(|_| code[..end].ends_with("::")) else {
        return vec![head];
    };
    let mut all = Vec::new();
    let (mut depth, mut begin) = (0, 0);
    for (at, letter) in group.char_indices() {
        match letter {
            '{' => depth += 1,
            '}' if depth > 0 => depth -= 1,
            ',' | '}' if depth == 0 => {
                let inner = paths(group[begin..at].trim_start()).into_iter();
                all.extend(inner.map(|rest| [head.clone(), rest].concat()));
                begin = at + 1;
                if letter == '}' {
                    break;
                }
            }
            _ => {}
        }
    }
    all
}

/// Resolves a path in the module `own` to the module of the file that it leads to.
fn resolved(own: &Module, path: &[String], files: &BTreeMap<Module, &Source>) -> Module {
    let mut place = if path[0] == "crate" { Vec::new() } else { own.clone() };
    for part in path.iter().filter(|part| !["crate", "self"].contains(&part.as_str())) {
        if part == "super" {
            place.pop();
            continue;
        }
        place.push(part.clone());
        if !files.contains_key(&place) {
            place.pop();
            break;
        }
    }
    place
}
