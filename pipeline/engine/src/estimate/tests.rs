use super::*;
use crate::recipe::tests::plan;

const RECIPE: &str = r#"
[axes]
letter = ["a", "b"]
[nodes.text]
stage = "test-write"
[nodes.work]
stage = "test-work"
over = ["letter"]
inputs = { text = "text" }
params = { letter = "{letter}", steps = 10 }
"#;

/// A plan with this number of steps, and its node for the letter `a`.
fn steps(steps: f64) -> (Plan, Node) {
    let mut plan = plan(RECIPE, &[]);
    let index = plan.index_of("work/a").unwrap();
    plan.nodes[index].work = Work::of("a", steps);
    let node = plan.nodes[index].clone();
    (plan, node)
}

/// The relative error of a prediction.
fn error(predicted: Option<f64>, secs: f64) -> f64 {
    (predicted.unwrap() / secs - 1.0).abs()
}

#[test]
fn times_grow_with_the_work() {
    let mut estimator = Estimator::default();
    let (plan, ten) = steps(10.0);
    assert_eq!(estimator.secs(&plan, &ten), None);
    estimator.add_run(&plan, &ten, 2.0);
    for (amount, secs) in [(10.0, 2.0), (500.0, 100.0), (1.0, 0.2)] {
        let (plan, node) = steps(amount);
        assert!(error(estimator.secs(&plan, &node), secs) < 1e-9, "{amount}");
    }
    let (plan, far) = steps(20_000.0);
    assert_eq!(estimator.secs(&plan, &far), None, "2000 times the work is not comparable");
}

#[test]
fn kinds_and_devices_are_apart() {
    let mut estimator = Estimator::default();
    let (mut plan, node) = steps(10.0);
    estimator.add_run(&plan, &node, 2.0);
    let other = Node { work: Work::of("b", 10.0), ..node.clone() };
    assert_eq!(estimator.secs(&plan, &other), None);
    plan.device = crate::DeviceClass::Gpu;
    assert_eq!(estimator.secs(&plan, &node), None);
    estimator.add_run(&plan, &node, 0.1);
    assert!(error(estimator.secs(&plan, &node), 0.1) < 1e-9);
}

#[test]
fn the_costs_of_both_amounts_are_learnt() {
    // 1 ms per unit of the first amount, 20 ms per unit of the second.
    let secs = |[first, second]: [f64; 2]| 0.001 * first + 0.02 * second;
    let (plan, node) = steps(1.0);
    let of = |amounts| Node { work: Work::of_both("a", amounts), name: String::new(), ..node.clone() };
    let mut estimator = Estimator::default();
    for amounts in [[1e3, 1e3], [4e3, 1e3], [1e3, 5e3], [8e3, 2e3]] {
        estimator.add_run(&plan, &of(amounts), secs(amounts));
    }
    for amounts in [[64e3, 1e3], [2e3, 30e3], [3e3, 3e3]] {
        let predicted = estimator.secs(&plan, &of(amounts));
        assert!(error(predicted, secs(amounts)) < 0.3, "{amounts:?}: {predicted:?}");
    }
    assert!(Work::of_both("a", [f64::NAN, 1.0]).is_none() && Work::of("a", 0.0).is_none());
}

#[test]
fn a_job_of_unknown_work_takes_as_long_as_with_equal_parameters() {
    let (plan, node) = steps(1.0);
    let unknown = Node { work: None, ..node };
    let mut estimator = Estimator::default();
    estimator.add_run(&plan, &unknown, 3.0);
    assert_eq!(estimator.secs(&plan, &unknown), Some(3.0));
    let mut changed = unknown.clone();
    changed.params["steps"] = 11.into();
    assert_eq!(estimator.secs(&plan, &changed), None);
}

#[test]
fn ranges_narrow_with_measurements_and_widen_with_distance() {
    let mut estimator = Estimator::default();
    let (plan, ten) = steps(10.0);
    let width = |estimator: &Estimator, amount: f64| {
        let (plan, node) = steps(amount);
        let one = estimator.estimate(&plan, &node).unwrap();
        assert!(one.range_secs[0] < one.secs && one.secs < one.range_secs[1], "{one:?}");
        (one.range_secs[1] / one.range_secs[0], one.measurements)
    };
    estimator.add_run(&plan, &ten, 2.0);
    let (first, count) = width(&estimator, 10.0);
    assert_eq!(count, 1);
    assert!(width(&estimator, 1000.0).0 > first, "a prediction for 100 times the work is as certain");
    (0..9).for_each(|_| estimator.add_run(&plan, &ten, 2.0));
    let (tenth, count) = width(&estimator, 10.0);
    assert!(count == 10 && tenth < 0.8 * first, "{tenth} after {first}");
    (0..9).for_each(|at| estimator.add_run(&plan, &ten, if at % 2 == 0 { 1.0 } else { 4.0 }));
    assert!(width(&estimator, 10.0).0 > tenth, "scatter does not widen the range");
}

#[test]
fn shipped_measurements_predict_until_something_is_measured() {
    let (plan, node) = steps(10.0);
    let mut estimator = Estimator::default();
    let one =
        Shipped { stage: "test-work".into(), kind: "a".into(), device: "cpu".into(), amounts: [1.0, 0.0], secs: 1.0 };
    estimator.add_shipped(&[one]);
    let shipped = estimator.estimate(&plan, &node).unwrap();
    assert!(shipped.is_foreign && !shipped.has_same_job && error(Some(shipped.secs), 10.0) < 1e-9);
    assert!(shipped.range_secs[1] > 2.0 * shipped.secs, "{shipped:?}");
    estimator.add_run(&plan, &node, 2.0);
    let measured = estimator.estimate(&plan, &node).unwrap();
    assert!(!measured.is_foreign && measured.has_same_job && error(Some(measured.secs), 2.0) < 1e-9);
}

#[test]
fn a_run_here_replaces_the_time_of_a_job_without_work_on_another_machine() {
    let (plan, mut node) = steps(10.0);
    node.work = None;
    let mut estimator = Estimator::default();
    let job = [node.stage.clone(), node.name.clone()];
    estimator.foreign.insert(job.to_vec());
    estimator.last.insert(job, (node.params.clone(), 5.0));
    assert!(estimator.estimate(&plan, &node).unwrap().is_foreign);
    estimator.add_run(&plan, &node, 2.0);
    let measured = estimator.estimate(&plan, &node).unwrap();
    assert!(!measured.is_foreign && measured.secs == 2.0, "{measured:?}");
}
