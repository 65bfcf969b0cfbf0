//! Docstrings of the workspace's types, read from the sources.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use syn::{Attribute, Expr, ExprLit, Fields, ImplItem, Item, Lit, Meta, Type};
use walkdir::WalkDir;

/// The types of the stages and of the crates below them.
pub(super) struct Docs {
    root: PathBuf,
    structs: Vec<(String, String, Vec<Field>)>,
    /// Path of the file, name, and values of enums without data.
    enums: Vec<(String, String, String)>,
    /// Path of the file, name, and type of associated types.
    associated: Vec<(String, String, String)>,
}

/// A field of a struct of parameters.
#[derive(Clone)]
pub(super) struct Field {
    /// The key in recipes.
    pub(super) key: String,
    /// The docstring on one line.
    pub(super) meaning: String,
    /// Name of the type, without an `Option` or a list around it.
    kind: String,
    /// The file that declares the field.
    file: String,
}

/// What a field's type means for a reference of keys.
pub(super) enum Shape {
    Table(Vec<Field>),
    Number {
        is_integer: bool,
    },
    /// The values to choose from.
    Choice(String),
    Other,
}

impl Docs {
    /// Reads all sources of the crates that define parameters.
    pub(super) fn scan(root: &Path) -> Self {
        let (structs, enums, associated) = Default::default();
        let mut docs = Self { root: root.to_owned(), structs, enums, associated };
        for part in ["stages", "pipeline", "shaders"] {
            let entries = WalkDir::new(root.join(part)).sort_by_file_name().into_iter();
            for path in entries.map(|entry| entry.expect("readable").into_path()) {
                let name = path.strip_prefix(root).expect("below the root").to_string_lossy().replace('\\', "/");
                if name.ends_with(".rs") && !name.contains("/tests") && !name.contains("/target/") {
                    let source = std::fs::read_to_string(&path).expect("readable");
                    let file = syn::parse_file(&source).unwrap_or_else(|error| panic!("{name}: {error}"));
                    docs.add(&name, file.items);
                }
            }
        }
        docs
    }

    fn add(&mut self, file: &str, items: Vec<Item>) {
        for item in items {
            match item {
                Item::Struct(item) => {
                    let Fields::Named(fields) = item.fields else { continue };
                    let fields = fields.named.into_iter().filter_map(|field| {
                        let name = field.ident.as_ref()?.to_string();
                        let key = renamed(&field.attrs).unwrap_or_else(|| name.trim_start_matches("r#").to_owned());
                        let meaning = one_line(&doc(&field.attrs));
                        Some(Field { key, meaning, kind: type_name(&field.ty), file: file.into() })
                    });
                    self.structs.push((file.into(), item.ident.to_string(), fields.collect()));
                }
                Item::Enum(item) if item.variants.iter().all(|variant| variant.fields.is_empty()) => {
                    let case = renamed_all(&item.attrs);
                    let values = item.variants.iter().map(|variant| {
                        let name = renamed(&variant.attrs).unwrap_or_else(|| case.apply(&variant.ident.to_string()));
                        format!("`\"{name}\"`: {}", one_line(&doc(&variant.attrs)))
                    });
                    let values: Vec<String> = values.collect();
                    self.enums.push((file.into(), item.ident.to_string(), values.join("<br>")));
                }
                Item::Impl(item) => {
                    for part in item.items {
                        if let ImplItem::Type(part) = part {
                            self.associated.push((file.into(), part.ident.to_string(), type_name(&part.ty)));
                        }
                    }
                }
                _ => {}
            }
        }
    }

    /// The fields of the associated type `name` of an impl in a file below `folder`.
    pub(super) fn associated_type(&self, folder: &str, name: &str) -> Vec<Field> {
        let here = self.associated.iter().find(|(file, other, _)| file.starts_with(folder) && other == name);
        let (file, _, kind) = here.unwrap_or_else(|| panic!("no type {name} = … in {folder}"));
        nearest(&self.structs, file, kind).unwrap_or_else(|| panic!("no struct {kind} for {file}")).clone()
    }

    /// The fields of a struct in a file below `folder`.
    pub(super) fn structure(&self, folder: &str, name: &str) -> Vec<Field> {
        nearest(&self.structs, folder, name).unwrap_or_else(|| panic!("no struct {name} in {folder}")).clone()
    }

    /// What a field's type means for a reference of keys.
    pub(super) fn shape(&self, field: &Field) -> Shape {
        match field.kind.as_str() {
            "f64" | "f32" => Shape::Number { is_integer: false },
            "u8" | "u16" | "u32" | "u64" | "usize" | "i32" | "i64" => Shape::Number { is_integer: true },
            kind => match (nearest(&self.structs, &field.file, kind), nearest(&self.enums, &field.file, kind)) {
                (Some(fields), _) => Shape::Table(fields.clone()),
                (None, Some(values)) => Shape::Choice(values.clone()),
                (None, None) => Shape::Other,
            },
        }
    }

    /// The module documentation of a file.
    pub(super) fn module(&self, file: &str) -> String {
        let source = std::fs::read_to_string(self.root.join(file)).expect("readable");
        let lines = source.lines().take_while(|line| line.starts_with("//!"));
        let lines = lines.map(|line| line.trim_start_matches("//!").strip_prefix(' ').unwrap_or_default());
        without_links(&lines.collect::<Vec<_>>().join("\n"))
    }

    /// Names of the folders in a folder, sorted.
    pub(super) fn folders(&self, folder: &str) -> Vec<String> {
        let entries =
            std::fs::read_dir(self.root.join(folder)).expect("a folder").map(|entry| entry.expect("an entry"));
        let folders = entries.filter(|entry| entry.path().is_dir());
        let mut names: Vec<String> = folders.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect();
        names.sort();
        names
    }
}

/// The item of this name whose file shares the longest beginning of its path with `file`.
fn nearest<'a, T>(items: &'a [(String, String, T)], file: &str, name: &str) -> Option<&'a T> {
    let common = |other: &str| other.bytes().zip(file.bytes()).take_while(|(a, b)| a == b).count();
    let named = items.iter().filter(|(_, other, _)| other == name);
    named.max_by_key(|(other, ..)| common(other)).map(|(_, _, item)| item)
}

/// The last segment of a type's path, without an `Option` or a list around it.
fn type_name(kind: &Type) -> String {
    let Type::Path(path) = kind else { return String::new() };
    let Some(last) = path.path.segments.last() else { return String::new() };
    if ["Option", "Vec", "BTreeSet"].iter().any(|wrapper| last.ident == wrapper)
        && let syn::PathArguments::AngleBracketed(arguments) = &last.arguments
        && let Some(syn::GenericArgument::Type(inner)) = arguments.args.first()
    {
        return type_name(inner);
    }
    last.ident.to_string()
}

fn doc(attributes: &[Attribute]) -> String {
    let lines = attributes.iter().filter(|attribute| attribute.path().is_ident("doc")).filter_map(|attribute| {
        let Meta::NameValue(meta) = &attribute.meta else { return None };
        let Expr::Lit(ExprLit { lit: Lit::Str(text), .. }) = &meta.value else { return None };
        Some(text.value().trim().to_owned())
    });
    lines.collect::<Vec<_>>().join("\n")
}

/// A docstring as the cell of a table.
fn one_line(doc: &str) -> String {
    without_links(&doc.replace('\n', " ")).replace('|', "\\|")
}

/// The text with links to items as plain code: "[`X`](path)" becomes "`X`".
fn without_links(text: &str) -> String {
    let mut parts = text.split("[`");
    let mut plain = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        let (name, rest) = part.split_once("`]").unwrap_or((part, ""));
        let rest = match rest.strip_prefix('(') {
            Some(target) => target.split_once(')').map_or("", |(_, rest)| rest),
            None => rest,
        };
        plain += &format!("`{name}`{rest}");
    }
    plain
}

/// The value of `#[serde(rename = "…")]`.
fn renamed(attributes: &[Attribute]) -> Option<String> {
    serde_values(attributes).remove("rename")
}

fn renamed_all(attributes: &[Attribute]) -> Case {
    match serde_values(attributes).remove("rename_all").as_deref() {
        Some("kebab-case") => Case::Words("-"),
        Some("snake_case") => Case::Words("_"),
        Some("lowercase") => Case::Words(""),
        _ => Case::Unchanged,
    }
}

/// How serde renames the variants of an enum.
enum Case {
    /// Lower case with this between words.
    Words(&'static str),
    Unchanged,
}

impl Case {
    fn apply(&self, name: &str) -> String {
        let Self::Words(between) = self else { return name.to_owned() };
        let mut text = String::new();
        for c in name.chars() {
            if c.is_uppercase() && !text.is_empty() {
                text += between;
            }
            text.extend(c.to_lowercase());
        }
        text
    }
}

/// The `name = "value"` pairs of serde's attributes.
fn serde_values(attributes: &[Attribute]) -> BTreeMap<String, String> {
    let mut values = BTreeMap::new();
    for attribute in attributes.iter().filter(|attribute| attribute.path().is_ident("serde")) {
        let read = attribute.parse_nested_meta(|meta| {
            if let Ok(value) = meta.value() {
                let text: syn::LitStr = value.parse()?;
                values.insert(meta.path.require_ident()?.to_string(), text.value());
            }
            Ok(())
        });
        read.expect("an attribute of serde");
    }
    values
}
