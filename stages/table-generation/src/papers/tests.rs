//! The tables of papers are sound, and faulty ones are refused.

use super::*;
use crate::statistics::mean;

#[test]
fn printed_means_are_means_of_printed_scenes_unless_a_note_says_otherwise() {
    let mut n_checked = 0;
    for paper in built_in().expect("valid tables") {
        for table in &paper.tables {
            for row in table.rows.iter().filter(|_| !table.scenes.is_empty()) {
                let cells = row.cells();
                for (at, column) in table.columns.iter().enumerate() {
                    let place = table.place(row, column);
                    let Some(figure) = place.figure.filter(|_| place.is_mean) else { continue };
                    let in_scene = |scene: &String| {
                        let same = |(_, other): &(usize, &Heading)| {
                            other.figure == column.figure && other.scene.as_ref() == Some(scene)
                        };
                        let (at, _) = table.columns.iter().enumerate().find(same)?;
                        figure.value(cells[at])
                    };
                    let printed: Option<Vec<f64>> = table.scenes.iter().map(in_scene).collect();
                    let (Some(printed), Some(printed_mean)) = (printed, figure.value(cells[at])) else { continue };
                    let difference = mean(&printed).expect("scenes") - printed_mean;
                    // Half a unit in the last printed place of the mean and of its terms.
                    let place_of_last = 10.0_f64.powi(-(cells[at].split('.').nth(1).map_or(0, str::len) as i32));
                    let explained = table.notes.iter().chain(&row.notes).any(|note| note.contains("mean"));
                    let what = format!("{} {} {} {}", paper.name, table.number, row.label, column.label);
                    assert!(difference.abs() <= 1.01 * place_of_last || explained, "{what}: {difference}");
                    n_checked += 1;
                }
            }
        }
    }
    assert!(n_checked >= 30, "only {n_checked} means were checked");
}

#[test]
fn every_paper_claims_something_and_has_a_name_of_its_own() {
    assert_eq!(names().collect::<std::collections::BTreeSet<_>>().len(), built_in().expect("valid tables").len());
    let claims: Vec<_> = built_in().expect("valid tables").iter().map(|paper| paper.claims().len()).collect();
    // VC-GS prints scores of VBench alone, and KineticGS masked figures in all tables but two.
    assert_eq!(claims.iter().filter(|count| **count > 0).count(), 4, "{claims:?}");
    assert!(find("nothing").is_err());
}

#[test]
fn faulty_tables_are_refused() {
    let good = r#"
        name = "P"
        title = "T"
        [[table]]
        number = "Table 1"
        caption = "c"
        protocol = { dataset = "d" }
        scenes = ["a", "b"]
        columns = [{ label = "PSNR", figure = "psnr" }, { label = "Train", figure = "train_min" }]
        rows = [{ label = "M", method = "m", values = "30.00 | 5 min" }]"#;
    let paper = parse(good).expect("valid");
    let claims = paper.claims();
    assert_eq!(claims.len(), 1);
    let mean = claims[0].mean.as_ref().expect("a mean");
    assert_eq!((mean.values.psnr, mean.values.train_min), (Some(30.0), Some(5.0)));
    let planted = [
        ("30.00 | 5 min", "30.00"),
        ("30.00 | 5 min", "nan | 5 min"),
        ("30.00 | 5 min", "-3 | 5 min"),
        ("30.00 | 5 min", "30.00 | 5 weeks"),
        ("figure = \"psnr\"", "figure = \"pnsr\""),
        ("values =", "value ="),
    ];
    for (from, to) in planted {
        assert!(parse(&good.replace(from, to)).is_err(), "{to} was accepted");
    }
}
