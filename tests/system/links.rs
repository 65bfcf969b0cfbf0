//! Every relative link and image of a Markdown page resolves, and so does every anchor.

use std::collections::BTreeSet;

use crate::product::root;
use crate::tidy::tracked_files;

/// The targets of all links and images in a page, outside of code.
fn targets(page: &str) -> Vec<String> {
    let text = without_code(page);
    let inline = text.split("](").skip(1).filter_map(|rest| rest.split_once(')'));
    let definitions = text.lines().filter(|line| line.starts_with('[')).filter_map(|line| line.split_once("]: "));
    let inline = inline.map(|(target, _)| target);
    let both = inline.chain(definitions.map(|(_, target)| target));
    // A title may follow the target.
    both.filter_map(|target| target.split_whitespace().next()).map(str::to_owned).collect()
}

/// The page without fenced blocks and inline code.
fn without_code(page: &str) -> String {
    let mut fenced = false;
    let mut text = String::new();
    for line in page.lines() {
        if line.trim_start().starts_with("```") {
            fenced = !fenced;
        } else if !fenced {
            text.extend(line.split('`').step_by(2).flat_map(|part| [part, " "]));
            text.push('\n');
        }
    }
    text
}

/// The anchors of a page's headings, as code hosts derive them: lower case, spaces to hyphens, other signs dropped.
fn anchors(page: &str) -> BTreeSet<String> {
    let mut fenced = false;
    let mut found = BTreeSet::new();
    for line in page.lines() {
        fenced ^= line.trim_start().starts_with("```");
        if let Some(heading) = line.strip_prefix('#').filter(|_| !fenced) {
            let heading = heading.trim_start_matches('#').trim().to_lowercase().replace(' ', "-");
            let anchor: String = heading.chars().filter(|c| c.is_alphanumeric() || "-_".contains(*c)).collect();
            let repeated = (1..).map(|number| format!("{anchor}-{number}")).find(|name| !found.contains(name));
            found.insert(if found.contains(&anchor) { repeated.unwrap_or_default() } else { anchor });
        }
    }
    found
}

/// Every link of the page `name` that leads nowhere. `read` returns a file's text, empty for folders and binary files,
/// or nothing if the path does not exist.
fn broken(name: &str, page: &str, read: &dyn Fn(&str) -> Option<String>) -> Vec<String> {
    let mut found = Vec::new();
    for target in targets(page) {
        if target.contains("://") || target.starts_with("mailto:") {
            continue;
        }
        let (path, anchor) = target.split_once('#').unwrap_or((&target, ""));
        let text =
            if path.is_empty() { Some(page.to_owned()) } else { resolved(name, path).and_then(|path| read(&path)) };
        match text {
            None => found.push(format!("{name}: {target} does not exist")),
            Some(text) if !anchor.is_empty() && !anchors(&text).contains(anchor) => {
                found.push(format!("{name}: {target} names no heading"));
            }
            Some(_) => (),
        }
    }
    found
}

/// The path, relative to the root, that a link on the page `name` leads to; none for paths outside of the project.
fn resolved(name: &str, path: &str) -> Option<String> {
    let mut parts: Vec<&str> = name.split('/').collect();
    parts.pop();
    for part in path.split('/').filter(|part| !part.is_empty() && *part != ".") {
        match part {
            ".." => drop(parts.pop()?),
            _ => parts.push(part),
        }
    }
    Some(parts.join("/"))
}

#[test]
fn every_link_of_every_page_resolves() {
    let read = |path: &str| {
        let path = root().join(path);
        path.exists().then(|| std::fs::read_to_string(path).unwrap_or_default())
    };
    let pages: Vec<_> = tracked_files().into_iter().filter(|(name, _)| name.ends_with(".md")).collect();
    assert!(pages.iter().any(|(_, page)| !targets(page).is_empty()), "no links in {} pages", pages.len());
    let found: Vec<String> = pages.iter().flat_map(|(name, page)| broken(name, page, &read)).collect();
    assert_eq!(found, Vec::<String>::new());
}

#[test]
fn a_broken_link_is_noticed() {
    let read = |path: &str| match path {
        "a/README.md" => Some("# One, `two` & three\n## One\n## One\n```\n# no heading\n```\n".to_owned()),
        "a" | "b.png" => Some(String::new()),
        _ => None,
    };
    let good = "[x](a/README.md) ![y](b.png \"title\") [z](a/README.md#one-two--three) [w](a/README.md#one-1)\n\
                [a](a/) [u](https://example.org/x#y) [i](#here)\n# Here\n[d]: ./b.png\n`[c](c.md)`\n```\n[e](e.md)\n```\n";
    assert_eq!(broken("README.md", good, &read), Vec::<String>::new());
    assert_eq!(broken("a/b/page.md", "[x](../README.md#one) [y](../../b.png)", &read), Vec::<String>::new());
    for wrong in ["[x](c.md)", "![x](c.png)", "[x](a/README.md#two)", "[x](#no-heading)", "[x](../b.png)", "[d]: c.md"]
    {
        assert_eq!(broken("README.md", wrong, &read).len(), 1, "{wrong}");
    }
}
