//! Repeated runs of a recipe give equal bytes.

use crate::product::World;

#[test]
fn artifacts_do_not_depend_on_threads() {
    let one = World::tiny().run(&["--threads", "1"]);
    let three = World::tiny().run(&["--threads", "3", "--jobs", "2"]);
    assert_eq!(one.timeless(), three.timeless());
    let other = World::tiny().run(&["-s", "nodes.train.params.seed=1"]);
    assert_ne!(one.timeless(), other.timeless(), "another seed changes the artifacts");
}
