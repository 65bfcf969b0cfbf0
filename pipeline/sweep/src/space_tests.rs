//! Values, conditions and grids.

use super::*;

#[test]
fn values_are_read_and_written_as_toml() {
    let parameter = |text: &str| text.parse::<Parameter>().unwrap();
    let choices = parameter("a.b=0.1, true,word,[1,2],\"x,y\"");
    assert_eq!(choices.count(), Some(5));
    let all: Vec<String> = (0..5).map(|at| choices.at((f64::from(at) + 0.5) / 5.0)).collect();
    assert_eq!(all, ["0.1", "true", "\"word\"", "[1,2]", "\"x,y\""]);
    let log = parameter("lr=log(1e-4, 1e-2)");
    assert_eq!((log.at(0.0).as_str(), log.at(0.5).as_str()), ("0.0001", "0.001"));
    let whole = parameter("n=int(1, 3)");
    assert_eq!([0.0, 0.34, 0.999, 1.0].map(|at| whole.at(at)), ["1", "2", "3", "3"]);
    assert_eq!(parameter("n=uniform(0, 1)").at(0.25), "0.25");
    for text in [choices.to_string(), log.to_string(), whole.to_string()] {
        assert_eq!(parameter(&text).to_string(), text);
    }
    for wrong in [
        "",
        "a",
        "=1",
        "a=",
        "a=log(0, 1)",
        "a=log(1)",
        "a=uniform(2, 1)",
        "a=uniform(0, inf)",
        "a=int(x, 2)",
        "a=int(0.5, 1)",
        "a=0.1,0.2,0.10",
        "a=x,\"x\"",
    ] {
        assert!(wrong.parse::<Parameter>().is_err(), "{wrong}");
    }
    assert!("a=int(0.5, 1)".parse::<Parameter>().unwrap_err().contains("whole numbers"));
    assert_eq!("a=x,y,x".parse::<Parameter>().unwrap_err(), "a: the value \"x\" occurs twice");
}

#[test]
fn contrasts_vary_one_parameter_around_all_values_of_the_others() {
    let texts = ["m=s,d,v", "n=1,2 when m=d", "r=log(0.1, 10)"];
    let space = Space(texts.iter().map(|text| text.parse().unwrap()).collect());
    let values = |at: usize| -> Vec<Vec<String>> {
        let text = |point: &Vec<f64>| space.assignments(point).join(" ");
        let group = |points: Vec<Vec<f64>>| points.iter().map(text).collect::<Vec<String>>();
        space.contrasts(at).map(group).collect()
    };
    let of_r = values(2);
    assert_eq!(of_r[0], ["m=\"s\" r=0.1", "m=\"s\" r=10.0"]);
    assert!(of_r.contains(&vec!["m=\"d\" n=1 r=0.1".into(), "m=\"d\" n=1 r=10.0".into()]), "{of_r:?}");
    assert_eq!(values(1)[0], ["m=\"d\" n=1 r=0.1", "m=\"d\" n=2 r=0.1"], "where it is set");
    assert_eq!(values(0)[0], ["m=\"s\" r=0.1", "m=\"d\" n=1 r=0.1", "m=\"v\" r=0.1"]);
}

#[test]
fn a_grid_has_each_combination_once() {
    let space = Space(vec!["a=1,2".parse().unwrap(), "b=int(1, 3)".parse().unwrap()]);
    assert_eq!(space.grid_size(), Some(6));
    let all: std::collections::BTreeSet<Vec<String>> =
        (0..6).map(|number| space.assignments(&space.grid_point(number))).collect();
    assert_eq!(all.len(), 6);
    assert_eq!(space.assignments(&space.grid_point(1)), ["a=1", "b=2"]);
    assert_eq!(Space(vec!["a=log(1, 2)".parse().unwrap()]).grid_size(), None);
}

#[test]
fn a_condition_sets_a_parameter_for_some_methods_only() {
    let space = |texts: &[&str]| Space(texts.iter().map(|text| text.parse().unwrap()).collect());
    let searched = space(&["axes.method=[\"scgs\"],[\"mcgs\"],[\"vcgs\"]", "nodes=64,128 when method=scgs|mcgs"]);
    let unknown = |_: &str| None;
    let searched = searched.settled(unknown).unwrap();
    assert_eq!(searched.assignments(&[0.1, 0.9]), ["axes.method=[\"scgs\"]", "nodes=128"]);
    assert_eq!(searched.assignments(&[0.9, 0.9]), ["axes.method=[\"vcgs\"]"]);
    assert_eq!(searched.grid_size(), Some(5), "vcgs has no nodes");
    let all: std::collections::BTreeSet<Vec<String>> =
        (0..5).map(|number| searched.assignments(&searched.grid_point(number))).collect();
    assert_eq!(all.len(), 5);
    assert_eq!(searched.0[1].to_string(), "nodes=64,128 when method=scgs|mcgs");

    let fixed = || space(&["a=1,2", "nodes=64,128 when method=scgs"]);
    let of_recipe = |methods: &[&str]| {
        let values = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect();
        let axis = AxisValues { chosen: values(methods), known: values(&["scgs", "vcgs"]) };
        fixed().settled(|name| (name == "method").then(|| axis.clone())).map(|space| space.grid_size())
    };
    assert_eq!((of_recipe(&["scgs"]), of_recipe(&["vcgs"])), (Ok(Some(4)), Ok(Some(2))));
    assert!(of_recipe(&["scgs", "vcgs"]).unwrap_err().message.contains("several values"));
    assert!(fixed().settled(unknown).unwrap_err().message.contains("nor an axis of the recipe"));
    let chained = space(&["a=1,2", "b=1,2 when a=1", "c=1,2 when b=1"]);
    assert!(chained.settled(unknown).unwrap_err().message.contains("a condition itself"));
    assert!("a=1,2 when method".parse::<Parameter>().unwrap_err().contains("when NAME=VALUE"));
}

#[test]
fn a_condition_with_an_unknown_value_is_refused() {
    let refused = |texts: &[&str], axis: &[&str]| {
        let space = Space(texts.iter().map(|text| text.parse().unwrap()).collect());
        let axis: std::collections::BTreeSet<String> = axis.iter().map(|name| (*name).to_owned()).collect();
        let values = AxisValues { chosen: axis.clone(), known: axis };
        let axis = |name: &str| (name == "method" && !values.known.is_empty()).then(|| values.clone());
        let error = space.settled(axis).unwrap_err();
        (error.message, error.unknown.unwrap())
    };
    let searched = "axes.method=[\"scgs\"],[\"mcgs\"]";
    let (message, (value, allowed)) = refused(&[searched, "nodes=1,2 when method=scgs|mgcs"], &["scgs", "vcgs"]);
    assert_eq!(message, "nodes: when method: there is no value `mgcs`");
    assert_eq!((value.as_str(), allowed), ("mgcs", ["mcgs", "scgs", "vcgs"].map(str::to_owned).into()));
    let (_, (_, allowed)) = refused(&["a=1,2", "nodes=1,2 when method=mcgs"], &["scgs"]);
    assert_eq!(allowed, ["scgs"]);
    let (_, (value, allowed)) = refused(&["n=int(1, 4)", "b=1,2 when n=5"], &[]);
    assert_eq!((value.as_str(), allowed), ("5", vec!["int(1, 4)".to_owned()]));
    let (_, (_, allowed)) = refused(&["n=uniform(0, 1)", "b=1,2 when n=0.5"], &[]);
    assert_eq!(allowed, ["uniform(0.0, 1.0)"]);
    let left_out = Space(vec![searched.parse().unwrap(), "nodes=1,2 when method=vcgs".parse().unwrap()]);
    let known = AxisValues { chosen: Default::default(), known: ["vcgs".to_owned()].into() };
    assert!(left_out.settled(|_| Some(known.clone())).is_ok(), "the recipe knows the value");
}
