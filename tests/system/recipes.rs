//! Every recipe plans, and a wrong one is refused with all of its errors.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use walkdir::WalkDir;

use crate::product::{Ended, World, program, root};

/// All recipes that can be run. `recipes/common` holds parts of recipes.
fn recipes() -> Vec<PathBuf> {
    let entries =
        WalkDir::new(root().join("recipes")).sort_by_file_name().into_iter().map(|entry| entry.expect("readable"));
    let paths = entries.map(walkdir::DirEntry::into_path);
    paths
        .filter(|path| {
            path.extension().is_some_and(|it| it == "toml") && !path.components().any(|it| it.as_os_str() == "common")
        })
        .collect()
}

#[test]
fn every_recipe_plans() {
    let recipes = recipes();
    assert!(recipes.len() >= 20, "only {} recipes are found", recipes.len());
    for recipe in recipes {
        let plan = engine::recipe::resolve(&recipe, &[], &cli::stages(), Path::new("data"));
        let plan = plan.unwrap_or_else(|errors| panic!("{}:\n{errors}", recipe.display()));
        assert!(plan.nodes.iter().any(|node| node.stage == "table-generation"), "{} has no table", recipe.display());
    }
}

/// The values of an axis in a plan.
fn values<'a>(plan: &'a engine::Plan, axis: &str) -> BTreeSet<&'a str> {
    plan.nodes.iter().filter_map(|node| node.coordinates.get(axis)).map(String::as_str).collect()
}

#[test]
fn every_method_is_in_ci_and_in_the_hard_cases() {
    let stages = cli::stages();
    let methods = stages.get("training").and_then(|stage| stage.values("method")).expect("training lists its methods");
    let all: BTreeSet<&str> = methods.iter().map(String::as_str).collect();
    assert!(all.len() > 5, "{all:?}");
    for name in ["ci", "hard-cases", "suite-synthetic"] {
        let plan =
            engine::recipe::resolve(&root().join(format!("recipes/{name}.toml")), &[], &stages, Path::new("data"));
        let plan = plan.unwrap_or_else(|errors| panic!("{errors}"));
        assert_eq!(values(&plan, "method"), all, "{name}");
    }
}

/// A parameter of a training or evaluation of a recipe, by its dotted key.
pub(crate) fn param(plan: &engine::Plan, node: &str, key: &str) -> serde_json::Value {
    let found = plan.nodes.iter().find(|other| other.name == node);
    let mut value = &found.unwrap_or_else(|| panic!("no {node}")).params;
    for part in key.split('.') {
        value = value.get(part).unwrap_or_else(|| panic!("{node} has no {key}"));
    }
    value.clone()
}

#[test]
fn effects_of_one_method_do_not_concern_the_teacher_of_another() {
    let plan = |methods: &str| {
        let overrides = [format!("axes.method={methods}"), "nodes.train.params.effects=['+coarse-to-fine']".into()];
        let recipe = root().join("recipes/suite-synthetic.toml");
        engine::recipe::resolve(&recipe, &overrides, &cli::stages(), Path::new("data"))
    };
    let alone = plan("['deformable4dgs']").unwrap_or_else(|errors| panic!("{errors}"));
    assert_eq!(values(&alone, "method"), BTreeSet::from(["deformable4dgs"]));
    let errors = plan("['deformable4dgs', 'l4dgs']").expect_err("l4dgs has no such effect").to_string();
    assert!(errors.contains("l4dgs has no effect `coarse-to-fine`"), "{errors}");
}

#[test]
fn a_method_without_its_required_input_does_not_plan() {
    let overrides = ["axes.method=['static3dgs', 'vcgs']".to_owned()];
    let plan =
        engine::recipe::resolve(&root().join("recipes/quickstart.toml"), &overrides, &cli::stages(), Path::new("data"));
    let errors = plan.expect_err("nothing is wired to the priors").to_string();
    assert!(errors.contains("vcgs needs depth, but nothing is wired to the port `priors`"), "{errors}");
    assert!(errors.contains("hint: wire a depth-flow-import job to the port priors"), "{errors}");
    assert!(errors.contains("\"builtin:synthetic\""), "{errors}");
    let folder = tempfile::tempdir().expect("a folder");
    let recipe = folder.path().join("mine.toml");
    let text = "extends = [\"builtin:quickstart\", \"builtin:synthetic\"]\naxes.method = [\"vcgs\"]\n";
    std::fs::write(&recipe, text).expect("the recipe is written");
    let plan = engine::recipe::resolve(&recipe, &[], &cli::stages(), Path::new("data"));
    assert_eq!(values(&plan.unwrap_or_else(|errors| panic!("{errors}")), "method"), BTreeSet::from(["vcgs"]));
}

#[test]
fn a_recipe_replaces_the_capture_of_its_base() {
    let folder = tempfile::tempdir().expect("a folder");
    let recipe = folder.path().join("mine.toml");
    let base = root().join("recipes/quickstart.toml");
    let text = format!(
        "extends = [{:?}]\naxes.scene = [\"b\"]\n[nodes.capture]\nstage = \"sfm-import\"\nparams.source = \"{{scene}}\"\n",
        base.display().to_string()
    );
    std::fs::write(&recipe, text).expect("written");
    let plan = engine::recipe::resolve(&recipe, &[], &cli::stages(), Path::new("data"));
    let plan = plan.unwrap_or_else(|errors| panic!("{errors}"));
    assert_eq!(param(&plan, "capture/b", "source"), "b");
    assert_ne!(param(&plan, "capture/b", "width"), 112, "the width of the synthetic scenes");
}

/// The settings of a training apart from its method and effects; `field` points to those of its hexplane.
fn settings(node: &engine::Node, field: &str) -> serde_json::Value {
    let mut params = node.params.clone();
    let field = params.pointer(field).unwrap_or_else(|| panic!("{} has no {field}", node.name)).clone();
    let table = params.as_object_mut().expect("a table");
    for own in ["method", "effects", "without", "deformable4dgs", "phys4dgs"] {
        table.remove(own);
    }
    table.insert("field".into(), field);
    params
}

/// `recipes/common/equal-steps.toml`: otherwise, the difference between both rows would include that of the steps.
#[test]
fn the_base_with_the_steps_of_phys4dgs_differs_from_it_in_its_effects_only() {
    let mut recipes_with_base = 0;
    for recipe in recipes() {
        let plan =
            engine::recipe::resolve(&recipe, &[], &cli::stages(), Path::new("data")).expect("every recipe plans");
        let of = |template: &'static str| plan.nodes.iter().filter(move |node| node.template == template);
        recipes_with_base += usize::from(of("equal-train").next().is_some());
        for base in of("equal-train") {
            let is_compared = |node: &&engine::Node| {
                let has_same = |axis: &str| node.coordinates.get(axis) == base.coordinates.get(axis);
                let is_whole = node.coordinates.get("without").is_none_or(|part| part == "nothing");
                is_whole && node.params["method"] == "phys4dgs" && has_same("scene") && has_same("seed")
            };
            let compared: Vec<&engine::Node> = of("train").filter(is_compared).collect();
            assert!(!compared.is_empty(), "{}: phys4dgs is missing next to {}", recipe.display(), base.name);
            for node in compared {
                let [own, other] = [(node, "/phys4dgs/field"), (base, "/deformable4dgs")].map(|(n, f)| settings(n, f));
                assert_eq!(own, other, "{}: {} and {}", recipe.display(), node.name, base.name);
            }
        }
    }
    assert!(recipes_with_base >= 4, "only {recipes_with_base} recipes have the row");
}

/// It would train for long, and the report would rank its row, although no method needs it.
#[test]
fn without_phys4dgs_the_base_with_its_steps_is_not_trained() {
    let jobs = |method: &str| {
        let set = [format!("axes.method=[\"{method}\"]")];
        let recipe = root().join("recipes/dnerf.toml");
        let plan = engine::recipe::resolve(&recipe, &set, &cli::stages(), Path::new("data")).expect("it plans");
        plan.nodes.iter().filter(|node| node.template.starts_with("equal-")).count()
    };
    assert_eq!(jobs("static3dgs"), 0);
    assert!(jobs("phys4dgs") > 0);
}

#[test]
fn every_report_names_its_recipe() {
    for recipe in recipes() {
        let plan =
            engine::recipe::resolve(&recipe, &[], &cli::stages(), Path::new("data")).expect("every recipe plans");
        let own = recipe.strip_prefix(root()).expect("below the root").display().to_string();
        for report in plan.nodes.iter().filter(|node| node.stage == "table-generation") {
            // The report prints commands with this name. It could be missing, or inherited from another recipe.
            assert_eq!(report.params["recipe"].as_str(), Some(own.as_str()));
        }
    }
}

#[test]
fn the_report_of_an_extended_recipe_names_the_recipe_that_was_run() {
    let world = World::tiny();
    let [own, store] = ["own.toml", "store"].map(|name| world.path(name).display().to_string());
    let explained = |params: &str| {
        std::fs::write(&own, format!("extends = [\"builtin:quickstart\"]\n{params}")).unwrap();
        Ended::of(program(&["explain", &own, "report", "--store", &store])).ok()
    };
    let inherited = explained("");
    for expected in [format!("  recipe = \"{own}\""), "  title = \"own\"".into()] {
        assert!(inherited.contains(&expected), "no {expected} in\n{inherited}");
    }
    let stated = explained("nodes.report.params = { title = \"Mine\", recipe = \"mine.toml\" }\n");
    for expected in ["  recipe = \"mine.toml\"", "  title = \"Mine\""] {
        assert!(stated.contains(expected), "no {expected} in\n{stated}");
    }
}

#[test]
fn all_errors_of_a_recipe_come_at_once_with_line_and_suggestion() {
    let world = World::with_edit("density = { from = 10, interval = 10,", "density = { from = 10, intervall = 10,");
    let text = std::fs::read_to_string(world.recipe()).unwrap();
    std::fs::write(
        world.recipe(),
        text.replace("width = 32", "widht = 32").replace("\"scene-synthesis\"", "\"scene-synthesys\""),
    )
    .unwrap();
    let line_of = |needle: &str| text.lines().position(|line| line.contains(needle)).unwrap() + 1;
    let refused = world.call("run", &[]);
    assert_eq!(refused.code, 3, "{}", refused.stderr);
    let expected = [
        (line_of("density ="), "intervall", "interval"),
        (line_of("stage = \"scene"), "scene-synthesys", "scene-synthesis"),
    ];
    for (line, wrong, right) in expected {
        let place = format!("tiny.toml:{line}:");
        assert!(refused.stderr.contains(&place), "no {place} in\n{}", refused.stderr);
        assert!(refused.stderr.contains(wrong) && refused.stderr.contains(right), "{}", refused.stderr);
    }

    // With the stage spelled right, its parameters are checked too.
    std::fs::write(world.recipe(), text.replace("width = 32", "widht = 32")).unwrap();
    let refused = world.call("plan", &[]);
    assert_eq!(refused.code, 3, "{}", refused.stderr);
    for expected in [&*format!("tiny.toml:{}:", line_of("width = 32")), "`width`", "intervall", "2 errors"] {
        assert!(refused.stderr.contains(expected), "no {expected} in\n{}", refused.stderr);
    }
    assert!(!world.path("store/records").exists() || world.path("store/records").read_dir().unwrap().count() == 0);
}

#[test]
fn a_wrong_override_is_refused() {
    let world = World::tiny();
    let refused = world.call("run", &["-s", "nodes.train.params.desnity.from=5"]);
    assert_eq!(refused.code, 3);
    assert!(refused.stderr.contains("desnity") && refused.stderr.contains("density"), "{}", refused.stderr);
    let missing = Ended::of(program(&["plan", "no-such-recipe.toml"]));
    assert_eq!(missing.code, 3);
    assert!(missing.stderr.contains("no-such-recipe.toml"), "{}", missing.stderr);
}
