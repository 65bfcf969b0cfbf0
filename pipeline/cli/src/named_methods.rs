//! The methods that the parameters of reports name: a misspelt name would silently drop its comparisons.

use engine::plan::Origin;
use engine::recipe::{RecipeError, RecipeErrors};
use engine::{Node, Plan, Stage, names_hint};
use table_generation::{Base, TableGeneration, TableGenerationParams};
use training::Training;

/// Fails if `baseline` or `bases` of a report names neither a method nor a value of the recipe's axis `method`.
pub(crate) fn check(plan: &Plan) -> Result<(), RecipeErrors> {
    let mut known = Training::values("method").unwrap_or_default();
    for method in plan.nodes.iter().filter_map(|node| node.coordinates.get("method")) {
        if !known.contains(method) {
            known.push(method.clone());
        }
    }
    let mut errors = Vec::new();
    for report in plan.nodes.iter().filter(|node| node.stage == TableGeneration::ID) {
        let unknown = named(report).into_iter().filter(|(_, method)| !known.contains(method));
        errors.extend(unknown.map(|(key, method)| error(plan, report, &key, &method, &known)));
    }
    // Reports of one node have the same parameters.
    errors.dedup();
    if errors.is_empty() { Ok(()) } else { Err(RecipeErrors(errors)) }
}

/// The methods that a report's parameters name, each with its key.
fn named(report: &Node) -> Vec<(String, String)> {
    // The parameters of a plan are those of the stage.
    let params: TableGenerationParams = serde_json::from_value(report.params.clone()).unwrap_or_default();
    let of_bases = params.bases.into_iter().flat_map(|(method, base)| {
        let key = format!("bases.{method}");
        let base = base.parse().map_or(base, |base: Base| base.method);
        [(key.clone(), method), (key, base)]
    });
    [("baseline".to_owned(), params.baseline)].into_iter().chain(of_bases).collect()
}

fn error(plan: &Plan, report: &Node, key: &str, method: &str, known: &[String]) -> RecipeError {
    let (file, line) = match plan.origins.get(&report.name).and_then(|origins| origins.get(key)) {
        Some(Origin::File { file, line } | Origin::Set { file, line, .. }) => (file.clone(), *line),
        _ => ("-s".into(), 1),
    };
    RecipeError {
        file,
        line,
        column: 1,
        key: format!("nodes.{}.params.{key}", report.template),
        message: format!("unknown method `{method}`"),
        hint: Some(names_hint(method, known.iter().map(String::as_str))),
        source_line: String::new(),
        width: 0,
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::stages::stages;

    /// The errors of a recipe with these parameters of the report, without the lists of names.
    fn errors(params: &str) -> Vec<String> {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("own.toml");
        std::fs::write(&file, format!("extends = [\"builtin:quickstart\"]\n[nodes.report.params]\n{params}")).unwrap();
        let plan = engine::recipe::resolve(&file, &[], &stages(), Path::new("data")).unwrap();
        let text = |error: RecipeError| {
            let hint = error.hint.unwrap_or_default();
            let guess = hint.split("? ").next().unwrap_or_default();
            format!("{}: {}: {} ({guess})", error.line, error.key, error.message)
        };
        check(&plan).map_or_else(|errors| errors.0.into_iter().map(text).collect(), |()| Vec::new())
    }

    #[test]
    fn misspelt_methods_are_reported_with_line_and_suggestion() {
        assert_eq!(errors("baseline = \"mcgs\"\nbases.scgs = \"static3dgs\"\n"), Vec::<String>::new());
        let expected = [
            "3: nodes.report.params.baseline: unknown method `static3dg` (did you mean `static3dgs`)",
            "5: nodes.report.params.bases.mcgs: unknown method `scg` (did you mean `scgs`)",
            "4: nodes.report.params.bases.mgcs: unknown method `mgcs` (did you mean `mcgs`)",
        ];
        let with_axis = |method: &str| errors(&format!("bases.phys4dgs = \"{method} steps=of-phys4dgs\"\n"));
        assert_eq!(with_axis("deformable4dgs"), Vec::<String>::new());
        let expected_of_axis =
            "3: nodes.report.params.bases.phys4dgs: unknown method `deformable4dg` (did you mean `deformable4dgs`)";
        assert_eq!(with_axis("deformable4dg"), [expected_of_axis]);
        assert_eq!(errors("baseline = \"static3dg\"\nbases.mgcs = \"scgs\"\nbases.mcgs = \"scg\"\n"), expected);
    }
}
