//! Imports a capture without a recipe, the engine or a cache: `import_folder SOURCE OUTPUT [key=value …]`, with values in
//! JSON (e.g. `width=200 'background="black"'`).

use std::path::Path;

use anyhow::{Context as _, bail};
use serde_json::{Map, Value};

fn main() -> anyhow::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [source, output, settings @ ..] = &arguments[..] else {
        bail!("usage: import_folder SOURCE OUTPUT [key=value …]");
    };
    let mut params = Map::new();
    for setting in settings {
        let (key, value) = setting.split_once('=').with_context(|| format!("{setting} is not key=value"))?;
        params.insert(key.into(), serde_json::from_str(value).with_context(|| format!("{value} is not JSON"))?);
    }
    let params: sfm_import::Params = serde_json::from_value(Value::Object(params))?;
    println!("{}", sfm_import::inspect::inspect(Path::new(source))?.text());
    let capture = sfm_import::import(Path::new(source), &params, Path::new(output))?;
    println!("{} views: {}", capture.views.len(), capture.protocol.line());
    Ok(())
}
