//! A minimal reader of Rust source. It removes comments, strings and test modules. Then it collects the paths in `use`
//! trees and elsewhere, and the items of a file.

use std::fs;
use std::path::{Path, PathBuf};

/// Returns all Rust files below a folder, with their paths relative to it, sorted; skips `target` and `node_modules`.
pub fn all(folder: &Path) -> Vec<(PathBuf, String)> {
    let mut found = Vec::new();
    let mut folders = vec![folder.to_path_buf()];
    while let Some(next) = folders.pop() {
        for entry in fs::read_dir(&next).unwrap_or_else(|e| panic!("{}: {e}", next.display())) {
            let path = entry.unwrap().path();
            if path.is_dir() {
                if path.file_name().is_some_and(|n| n != "target" && n != "node_modules") {
                    folders.push(path);
                }
            } else if path.extension().is_some_and(|e| e == "rs") {
                let text = fs::read_to_string(&path).unwrap();
                found.push((path.strip_prefix(folder).unwrap().to_path_buf(), text));
            }
        }
    }
    found.sort();
    found
}

/// Returns the text without comments, strings, character literals, and items with `#[cfg(test)]`.
pub fn bare(text: &str) -> String {
    without_tests(&without_comments_and_strings(text))
}

/// Replaces comments and the contents of strings and character literals by blanks; keeps line breaks.
fn without_comments_and_strings(text: &str) -> String {
    let source: Vec<char> = text.chars().collect();
    let mut out = String::with_capacity(text.len());
    let mut at = 0;
    while at < source.len() {
        let rest = &source[at..];
        let end = if rest.starts_with(&['/', '/']) {
            rest.iter().position(|&c| c == '\n').unwrap_or(rest.len())
        } else if rest.starts_with(&['/', '*']) {
            block_comment(rest)
        } else if let Some(end) = raw_string(&source, at) {
            end
        } else if rest[0] == '"' {
            quoted(rest, '"')
        } else if rest[0] == '\'' && is_character(rest) {
            quoted(rest, '\'')
        } else {
            out.push(rest[0]);
            at += 1;
            continue;
        };
        out.extend(rest[..end].iter().map(|&c| if c == '\n' { '\n' } else { ' ' }));
        at += end;
    }
    out
}

fn block_comment(rest: &[char]) -> usize {
    let (mut depth, mut i) = (0, 0);
    while i < rest.len() {
        if rest[i..].starts_with(&['/', '*']) {
            depth += 1;
            i += 2;
        } else if rest[i..].starts_with(&['*', '/']) {
            depth -= 1;
            i += 2;
            if depth == 0 {
                return i;
            }
        } else {
            i += 1;
        }
    }
    rest.len()
}

/// Returns the length of a raw string that starts at `at`, as in `r#"..."#`.
fn raw_string(source: &[char], at: usize) -> Option<usize> {
    if at > 0 && (source[at - 1].is_alphanumeric() && source[at - 1] != 'b' || source[at - 1] == '_') {
        return None;
    }
    let rest = source[at..].strip_prefix(&['r'])?;
    let hashes = rest.iter().take_while(|&&c| c == '#').count();
    if rest.get(hashes) != Some(&'"') {
        return None;
    }
    let close: Vec<char> = std::iter::once('"').chain(std::iter::repeat_n('#', hashes)).collect();
    let body = &rest[hashes + 1..];
    let length = body.windows(close.len()).position(|w| w == close.as_slice()).unwrap_or(body.len() - close.len());
    Some(1 + hashes + 1 + length + close.len())
}

fn quoted(rest: &[char], quote: char) -> usize {
    let mut i = 1;
    while i < rest.len() {
        match rest[i] {
            '\\' => i += 2,
            c if c == quote => return i + 1,
            _ => i += 1,
        }
    }
    rest.len()
}

/// Returns whether a quote starts a character literal, not a lifetime.
fn is_character(rest: &[char]) -> bool {
    rest.get(1) == Some(&'\\') || rest.get(2) == Some(&'\'')
}

/// Removes each item that follows `#[cfg(test)]`. The text must be free of strings and comments.
fn without_tests(text: &str) -> String {
    const MARK: &str = "#[cfg(test)]";
    let mut out = String::new();
    let mut rest = text;
    while let Some(at) = rest.find(MARK) {
        out.push_str(&rest[..at]);
        let item = &rest[at + MARK.len()..];
        let mut depth = 0_usize;
        let mut end = item.len();
        for (i, c) in item.char_indices() {
            match c {
                '{' => depth += 1,
                '}' => {
                    depth = depth.saturating_sub(1);
                    if depth == 0 {
                        end = i + 1;
                        break;
                    }
                }
                ';' if depth == 0 => {
                    end = i + 1;
                    break;
                }
                _ => {}
            }
        }
        rest = &item[end..];
    }
    out.push_str(rest);
    out
}

/// Splits a text into names, numbers and punctuation, in order; `::` is one token.
pub fn lex(text: &str) -> Vec<String> {
    let mut found: Vec<String> = Vec::new();
    let mut chars = text.chars().peekable();
    while let Some(c) = chars.next() {
        let mut word = String::from(c);
        if c.is_alphanumeric() || c == '_' {
            while let Some(&next) = chars.peek() {
                if !(next.is_alphanumeric() || next == '_') {
                    break;
                }
                word.push(next);
                chars.next();
            }
        } else if c == ':' && chars.peek() == Some(&':') {
            chars.next();
            word.push(':');
        } else if c.is_whitespace() {
            continue;
        }
        found.push(word);
    }
    found
}

/// An item with a body: `struct`, `enum`, `trait`, `impl` or `fn`.
pub struct Item {
    pub kind: String,
    /// Its name; for an `impl`, the name of the type.
    pub name: String,
    /// All tokens from the keyword to the end.
    pub body: Vec<String>,
}

impl Item {
    /// Returns the names of the functions in this item. If the item is a function, returns its own name.
    pub fn functions(&self) -> Vec<String> {
        let mut found = Vec::new();
        let mut at = 0;
        while at + 1 < self.body.len() {
            // A `fn` without a name is a type, such as `fn(u8)`.
            if self.body[at] == "fn" && is_name(&self.body[at + 1]) {
                let end = end_of(&self.body, at);
                if self.body[end] == "}" {
                    found.push(self.body[at + 1].clone());
                }
                at = end;
            }
            at += 1;
        }
        found
    }
}

/// Returns the index of the last token of the item that starts at `at`: its closing brace, or its semicolon if it has
/// no body.
fn end_of(tokens: &[String], at: usize) -> usize {
    let (mut depth, mut braces) = (0_usize, 0_usize);
    for (i, token) in tokens.iter().enumerate().skip(at) {
        match token.as_str() {
            "(" | "[" => depth += 1,
            ")" | "]" => depth = depth.saturating_sub(1),
            "{" => braces += 1,
            "}" => {
                braces = braces.saturating_sub(1);
                if braces == 0 && depth == 0 {
                    return i;
                }
            }
            ";" if braces == 0 && depth == 0 => return i,
            _ => {}
        }
    }
    tokens.len() - 1
}

/// Returns the items of a file. Items of inline modules are included; items within other items are not.
pub fn items(tokens: &[String]) -> Vec<Item> {
    let mut found = Vec::new();
    let mut at = 0;
    while at + 1 < tokens.len() {
        let word = tokens[at].as_str();
        if !["struct", "enum", "trait", "impl", "fn"].contains(&word) {
            at += 1;
            continue;
        }
        let end = end_of(tokens, at);
        let body = tokens[at..=end].to_vec();
        let name = if word == "impl" { type_of_impl(&body) } else { tokens[at + 1].clone() };
        found.push(Item { kind: word.to_owned(), name, body });
        at = end + 1;
    }
    found
}

/// Returns the name of the type of an `impl`, without its path and its parameters: `Ring` for `impl<T> Display for
/// log::Ring<T>`.
fn type_of_impl(tokens: &[String]) -> String {
    let (mut angles, mut name) = (0_usize, String::new());
    for (i, token) in tokens.iter().enumerate().skip(1) {
        match token.as_str() {
            "<" => angles += 1,
            ">" if tokens[i - 1] != "-" => angles = angles.saturating_sub(1),
            "for" if angles == 0 => name.clear(),
            "{" | "where" if angles == 0 => break,
            word if angles == 0 && is_name(word) => name = word.to_owned(),
            _ => {}
        }
    }
    name
}

/// Returns the names of the methods called on `self`, and of the functions called on `Self`.
pub fn calls_of_self(body: &[String]) -> Vec<String> {
    let is = |token: &String, text: &str| token == text;
    let receives = |w: &[String]| is(&w[0], "self") && is(&w[1], ".") || is(&w[0], "Self") && is(&w[1], "::");
    body.windows(4).filter(|w| receives(w) && is_name(&w[2]) && is(&w[3], "(")).map(|w| w[2].clone()).collect()
}

/// Returns all names, keywords and numbers of the text, in order.
pub fn words(text: &str) -> impl Iterator<Item = String> {
    lex(text).into_iter().filter(|t| t.starts_with(|c: char| c.is_alphanumeric() || c == '_'))
}

fn is_name(token: &str) -> bool {
    token.starts_with(|c: char| c.is_alphabetic() || c == '_')
}

/// Returns every path of two or more names, in `use` trees and elsewhere.
pub fn paths(text: &str) -> Vec<Vec<String>> {
    let tokens = lex(text);
    let mut found = Vec::new();
    let mut at = 0;
    while at < tokens.len() {
        if tokens[at] == "use" {
            at += 1;
            tree(&tokens, &mut at, &[], &mut found);
        } else if is_name(&tokens[at]) && tokens.get(at + 1).is_some_and(|t| t == "::") {
            let mut path = vec![tokens[at].clone()];
            while tokens.get(at + 1).is_some_and(|t| t == "::") && tokens.get(at + 2).is_some_and(|t| is_name(t)) {
                path.push(tokens[at + 2].clone());
                at += 2;
            }
            found.push(path);
            at += 1;
        } else {
            at += 1;
        }
    }
    found
}

/// Collects one tree of a `use`: a path that can end in `*`, in `as name`, or in a group of trees.
fn tree(tokens: &[String], at: &mut usize, prefix: &[String], found: &mut Vec<Vec<String>>) {
    let mut path = prefix.to_vec();
    while let Some(token) = tokens.get(*at) {
        match token.as_str() {
            "::" => *at += 1,
            "{" => {
                *at += 1;
                while tokens.get(*at).is_some_and(|t| t != "}") {
                    tree(tokens, at, &path, found);
                    if tokens.get(*at).is_some_and(|t| t == ",") {
                        *at += 1;
                    }
                }
                *at += 1;
                return;
            }
            "*" => *at += 1,
            "as" => *at += 2,
            name if is_name(name) => {
                path.push(name.to_string());
                *at += 1;
            }
            _ => break,
        }
    }
    found.push(path);
}
