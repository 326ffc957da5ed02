//! Rust source as the rules see it: without comments and string literals, function by function.

use std::fs;
use std::path::{Path, PathBuf};

/// Folders with no files of ours.
const NOT_OURS: [&str; 5] = ["node_modules", "target", "runs", "demonstrations", "__pycache__"];

/// A source file.
pub(crate) struct Source {
    /// Its path from the workspace's root.
    pub(crate) path: String,
    /// The file's text as written.
    pub(crate) text: String,
    /// The text with comments, string and character literals blanked out; line numbers are unchanged.
    pub(crate) code: String,
}

/// A function in a file.
pub(crate) struct Function {
    pub(crate) name: String,
    /// Line of its `fn`, from 1.
    pub(crate) line: usize,
    /// Lines from its `fn` to its closing brace.
    pub(crate) lines: usize,
}

/// Returns the root of the workspace.
pub(crate) fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap()
}

/// Lists every file of the workspace except in hidden folders and [`NOT_OURS`], by its path from the root, sorted.
pub(crate) fn files() -> Vec<PathBuf> {
    let mut files = Vec::new();
    let mut folders = vec![root().to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).unwrap() {
            let path = entry.unwrap().path();
            let name = path.file_name().unwrap().to_string_lossy().into_owned();
            if !path.is_dir() {
                files.push(path.strip_prefix(root()).unwrap().to_owned());
            } else if !name.starts_with('.') && !NOT_OURS.contains(&name.as_str()) {
                folders.push(path);
            }
        }
    }
    files.sort();
    files
}

/// Reads every Rust file of the workspace.
pub(crate) fn sources() -> Vec<Source> {
    let is_rust = |path: &PathBuf| path.extension().is_some_and(|ending| ending == "rs");
    let read = |path: PathBuf| {
        let text = fs::read_to_string(root().join(&path)).unwrap();
        Source { path: path.display().to_string(), code: code_of(&text), text }
    };
    files().into_iter().filter(is_rust).map(read).collect()
}

impl Source {
    /// Returns whether the file is in this folder.
    pub(crate) fn is_in(&self, folder: &str) -> bool {
        self.path.starts_with(folder)
    }

    /// Returns the lines, from 1, whose code has this word, or these words joined by `::`.
    pub(crate) fn lines_with(&self, words: &str) -> Vec<usize> {
        let lines = self.code.lines().zip(1..);
        lines.filter(|(line, _)| has_words(line, words)).map(|(_, number)| number).collect()
    }

    /// Returns every function with a body.
    pub(crate) fn functions(&self) -> Vec<Function> {
        let starts = self.code.match_indices("fn ").map(|(at, _)| at);
        let starts = starts.filter(|&at| !self.code[..at].ends_with(is_of_word));
        starts.filter_map(|at| self.function(at)).collect()
    }

    fn function(&self, at: usize) -> Option<Function> {
        let rest = &self.code[at..];
        let name: String = rest[3..].chars().take_while(|&letter| is_of_word(letter)).collect();
        let (mut depth, mut arguments) = (0_usize, 0_usize);
        for (offset, letter) in rest.char_indices() {
            match letter {
                '(' | '[' if depth == 0 => arguments += 1,
                ')' | ']' if depth == 0 => arguments = arguments.checked_sub(1)?,
                ';' if depth == 0 && arguments == 0 => return None,
                '{' => depth += 1,
                '}' if depth == 0 => return None,
                '}' if depth == 1 => {
                    let line = self.code[..at].matches('\n').count() + 1;
                    let lines = rest[..offset].matches('\n').count() + 1;
                    return (!name.is_empty()).then_some(Function { name, line, lines });
                }
                '}' => depth -= 1,
                _ => {}
            }
        }
        None
    }
}

fn is_of_word(letter: char) -> bool {
    letter.is_alphanumeric() || letter == '_'
}

fn has_words(line: &str, words: &str) -> bool {
    line.match_indices(words).any(|(at, _)| {
        let (before, after) = (&line[..at], &line[at + words.len()..]);
        !before.ends_with(is_of_word) && !after.starts_with(is_of_word)
    })
}

/// Blanks out comments, string and character literals.
fn code_of(text: &str) -> String {
    let mut code = String::with_capacity(text.len());
    let mut rest = text;
    while let Some(first) = rest.chars().next() {
        let length = not_code(rest, code.ends_with(is_of_word));
        let taken = &rest[..length.max(first.len_utf8())];
        if length == 0 {
            code.push(first);
        } else {
            let blanked = |letter| if letter == '\n' { '\n' } else { ' ' };
            code.extend(taken.chars().map(blanked));
        }
        rest = &rest[taken.len()..];
    }
    code
}

/// Returns the length in bytes of the comment, string or character literal that `rest` begins with; 0 for code.
fn not_code(rest: &str, within_word: bool) -> usize {
    let through = |end: &str, from: usize| {
        rest[from..].find(end).map_or(rest.len(), |at| from + at + end.len())
    };
    if rest.starts_with("//") {
        return rest.find('\n').unwrap_or(rest.len());
    }
    if rest.starts_with("/*") {
        return through("*/", 2);
    }
    let raw = rest.trim_start_matches('b');
    if !within_word && rest.len() - raw.len() <= 1 && raw.starts_with(['r']) {
        let hashes = raw[1..].len() - raw[1..].trim_start_matches('#').len();
        if raw[1 + hashes..].starts_with('"') {
            let end = format!("\"{}", "#".repeat(hashes));
            return through(&end, rest.len() - raw.len() + 2 + hashes);
        }
    }
    match rest.as_bytes()[0] {
        b'"' => quoted(rest, b'"'),
        b'\'' => character(rest),
        _ => 0,
    }
}

fn quoted(rest: &str, quote: u8) -> usize {
    let bytes = rest.as_bytes();
    let mut at = 1;
    while at < bytes.len() && bytes[at] != quote {
        at += if bytes[at] == b'\\' { 2 } else { 1 };
    }
    (at + 1).min(bytes.len())
}

/// Returns the length of a character literal; 0 if the quote begins a lifetime.
fn character(rest: &str) -> usize {
    let mut letters = rest.char_indices().skip(1);
    match (letters.next(), letters.next()) {
        (Some((_, '\\')), _) => quoted(rest, b'\''),
        (Some(_), Some((at, '\''))) => at + 1,
        _ => 0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn source(text: &str) -> Source {
        Source { path: "a.rs".to_owned(), text: text.to_owned(), code: code_of(text) }
    }

    #[test]
    fn only_code_is_seen() {
        let found =
            source("let a = \"unsafe \\\" {\"; // unsafe\nlet b = 'u'; /* unsafe */ c<'a>\n");
        assert!(found.lines_with("unsafe").is_empty());
        assert!(found.code.contains("let b =") && found.code.contains("c<'a>"));
        let raw = source("call(r#\"unsafe \" {\"#); unsafe {}\nunsafely()\n");
        assert_eq!(raw.lines_with("unsafe"), [1]);
    }

    #[test]
    fn functions_are_measured() {
        let found = source(
            "fn one() -> [u8; 2] {\n    \"}\";\n}\ntrait T {\n    fn two();\n}\n\
             fn three<A, B>() -> Result<A, B>\nwhere\n    A: T,\n{\n}\n",
        );
        let functions = found.functions();
        let measured = functions.iter().map(|one| (one.name.as_str(), one.line, one.lines));
        assert_eq!(measured.collect::<Vec<_>>(), [("one", 1, 3), ("three", 7, 5)]);
    }
}
