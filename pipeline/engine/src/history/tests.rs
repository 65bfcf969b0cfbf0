use crate::{FailureKind, KeyComponents, KeyInput};

use super::loses_data;

/// The components of a table over captures, of which `lost` failed in this way and the others have results.
fn of_table(present: usize, (failure, lost): (FailureKind, usize)) -> KeyComponents {
    let with = |failure: Option<FailureKind>| KeyInput {
        content: failure.is_none().then(|| "0".to_owned()),
        failure,
        ..KeyInput::default()
    };
    let inputs = [vec![with(None); present], vec![with(Some(failure)); lost]].concat();
    KeyComponents {
        stage: "table-generation".into(),
        code: Default::default(),
        params: serde_json::Value::Null,
        inputs: [("model".to_owned(), inputs)].into(),
        sources: Default::default(),
        output: ("report".into(), 1),
        environment: "cpu".into(),
    }
}

#[test]
fn a_result_without_data_does_not_replace_one_with_more() {
    use FailureKind::{BadInput, Crashed, Diverged, MissingData, OutOfMemory, Timeout, World};
    for kind in [MissingData, BadInput, World] {
        assert!(loses_data(&of_table(4, (kind, 0)), &of_table(0, (kind, 4))), "{kind:?}");
        assert!(loses_data(&of_table(3, (kind, 1)), &of_table(1, (kind, 3))), "{kind:?}");
        assert!(!loses_data(&of_table(1, (kind, 3)), &of_table(3, (kind, 1))), "more data is better");
    }
    for kind in [Diverged, OutOfMemory, Timeout, Crashed] {
        assert!(!loses_data(&of_table(4, (kind, 0)), &of_table(2, (kind, 2))), "failures of methods are news");
    }
}
