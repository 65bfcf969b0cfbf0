//! Static facts about priors, known before the import runs.

use engine::{Facts, PlanContext};
use scene::facts;

use crate::Params;
use crate::from_files::{DEPTH, FLOW_FORWARD, NORMALS, TRACKS};
use crate::params::{MapKind, MapSource};

/// Predicts which maps the priors will have, from the facts of the capture or from the folders that exist.
pub(crate) fn of_priors(params: &Params, context: &PlanContext<'_>) -> Facts {
    let capture = context.facts("capture");
    let folder = context.data_root.join(&params.folder);
    let has_tracks = |name: &str| name == FLOW_FORWARD && folder.join(TRACKS).is_dir();
    let exists = |name: &str| folder.is_dir().then(|| folder.join(name).is_dir() || has_tracks(name));
    let maps = [
        (MapKind::Depth, facts::DEPTH, Some(DEPTH)),
        (MapKind::Flow, facts::FLOW, Some(FLOW_FORWARD)),
        (MapKind::Normals, facts::NORMALS, Some(NORMALS)),
        (MapKind::Velocity, facts::VELOCITY, None),
    ];
    maps.into_iter().fold(Facts::default(), |known, (kind, fact, name)| {
        let found = match (params.source, name) {
            (MapSource::Capture, _) if kind == MapKind::Normals => Some(false),
            (MapSource::Capture, _) => capture.and_then(|capture| capture.flag(fact)),
            (MapSource::SparsePoints, _) if kind == MapKind::Depth => {
                capture.and_then(|capture| capture.flag(facts::POINTS))
            }
            (MapSource::SparsePoints, _) | (MapSource::Files, None) => Some(false),
            (MapSource::Files, Some(DEPTH)) if params.fill_depth && exists(DEPTH) == Some(false) => {
                filled_depth(capture)
            }
            (MapSource::Files, Some(name)) => exists(name),
        };
        match if params.wants(kind) { found } else { Some(false) } {
            Some(found) => known.with(fact, found),
            None => known,
        }
    })
}

/// Whether depth that no file has can be filled: by the depth or between the points of the capture.
fn filled_depth(capture: Option<&Facts>) -> Option<bool> {
    let flag = |fact| capture.and_then(|capture| capture.flag(fact));
    if flag(facts::DEPTH) == Some(true) { Some(true) } else { flag(facts::POINTS) }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    fn context<'a>(data_root: &'a Path, capture: Facts) -> PlanContext<'a> {
        PlanContext { data_root, inputs: [("capture".to_owned(), vec![capture])].into() }
    }

    const MAPS: [&str; 4] = [facts::DEPTH, facts::FLOW, facts::NORMALS, facts::VELOCITY];

    fn flags(known: &Facts) -> [Option<bool>; 4] {
        MAPS.map(|map| known.flag(map))
    }

    #[test]
    fn facts_of_the_capture_are_limited_to_wanted_maps() {
        let capture = Facts::default().with(facts::DEPTH, true).with(facts::FLOW, true);
        let context = context(Path::new("nowhere"), capture);
        let all = of_priors(&Params::default(), &context);
        assert_eq!(flags(&all), [Some(true), Some(true), Some(false), None]);
        let depth = Params { maps: [MapKind::Depth].into(), ..Params::default() };
        assert_eq!(flags(&of_priors(&depth, &context)), [Some(true), Some(false), Some(false), Some(false)]);
    }

    #[test]
    fn sparse_points_give_depth_alone() {
        let params = Params { source: MapSource::SparsePoints, ..Params::default() };
        let known = Facts::default().with(facts::POINTS, true).with(facts::FLOW, true);
        let predicted = flags(&of_priors(&params, &context(Path::new("nowhere"), known)));
        assert_eq!(predicted, [Some(true), Some(false), Some(false), Some(false)]);
        let unknown = of_priors(&params, &context(Path::new("nowhere"), Facts::default()));
        assert_eq!(unknown.flag(facts::DEPTH), None);
    }

    #[test]
    fn existing_folders_predict_their_maps() {
        let root = tempfile::tempdir().unwrap();
        let params = Params { source: MapSource::Files, folder: "maps".into(), ..Params::default() };
        let absent = of_priors(&params, &context(root.path(), Facts::default()));
        assert_eq!(flags(&absent), [None, None, None, Some(false)]);
        std::fs::create_dir_all(root.path().join("maps/flow_fwd")).unwrap();
        let flow = of_priors(&params, &context(root.path(), Facts::default()));
        assert_eq!(flags(&flow), [Some(false), Some(true), Some(false), Some(false)]);
    }

    #[test]
    fn points_fill_the_depth_that_no_file_has() {
        let root = tempfile::tempdir().unwrap();
        std::fs::create_dir_all(root.path().join("maps/flow_fwd")).unwrap();
        let params = Params { source: MapSource::Files, folder: "maps".into(), fill_depth: true, ..Params::default() };
        let of = |capture: Facts| flags(&of_priors(&params, &context(root.path(), capture)));
        let with_points = Facts::default().with(facts::POINTS, true).with(facts::DEPTH, false);
        assert_eq!(of(with_points), [Some(true), Some(true), Some(false), Some(false)]);
        assert_eq!(of(Facts::default().with(facts::DEPTH, true))[0], Some(true));
        assert_eq!(of(Facts::default().with(facts::POINTS, false))[0], Some(false));
    }
}
