//! The papers' tables are consistent, and faulty ones are rejected.

use super::*;
use crate::library::{paper, paper_names, papers};
use crate::statistics::mean;

#[test]
fn printed_means_match_printed_scenes_unless_noted() {
    let mut n_checked = 0;
    for paper in papers().expect("valid tables") {
        for table in &paper.tables {
            for row in table.rows.iter().filter(|_| !table.scenes.is_empty()) {
                let cells = row.cells();
                for (at, column) in table.columns.iter().enumerate() {
                    let place = table.place(row, column);
                    let Some(quantity) = place.quantity.filter(|_| place.is_mean) else { continue };
                    let in_scene = |scene: &String| {
                        let same = |(_, other): &(usize, &Heading)| {
                            other.quantity == column.quantity && other.scene.as_ref() == Some(scene)
                        };
                        let (at, _) = table.columns.iter().enumerate().find(same)?;
                        quantity.value(cells[at])
                    };
                    let printed: Option<Vec<f64>> = table.scenes.iter().map(in_scene).collect();
                    let (Some(printed), Some(printed_mean)) = (printed, quantity.value(cells[at])) else { continue };
                    let difference = mean(&printed).expect("scenes") - printed_mean;
                    // Rounding allows half a unit in the last place of the mean and half a unit of its terms.
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
fn paper_files_yield_claims_about_their_methods() {
    let files = std::fs::read_dir(concat!(env!("CARGO_MANIFEST_DIR"), "/claims/papers")).expect("a folder");
    let stems: std::collections::BTreeSet<String> =
        files.map(|file| file.expect("a file").path().file_stem().expect("a name").display().to_string()).collect();
    assert_eq!(paper_names().map(String::from).collect::<std::collections::BTreeSet<_>>(), stems);
    let claims: Vec<_> = papers().expect("valid tables").iter().map(|paper| paper.claims().len()).collect();
    // VC-GS prints VBench scores only; KineticGS prints masked values in all tables but two.
    assert_eq!(claims.iter().filter(|count| **count > 0).count(), 4, "{claims:?}");
    assert!(paper("nothing").is_err());
}

#[test]
fn faulty_tables_are_rejected() {
    let good = r#"
        name = "P"
        title = "T"
        [[table]]
        number = "Table 1"
        caption = "c"
        protocol = { dataset = "d" }
        scenes = ["a", "b"]
        columns = [{ label = "PSNR", quantity = "psnr" }, { label = "Train", quantity = "train_min" }]
        rows = [{ label = "M", method = "m", values = "30.00 | 5 min" }]"#;
    let paper = Paper::parse(good).expect("valid");
    let claims = paper.claims();
    assert_eq!(claims.len(), 1);
    let mean = claims[0].mean.as_ref().expect("a mean");
    assert_eq!((mean.values.psnr, mean.values.train_min), (Some(30.0), Some(5.0)));
    let planted = [
        ("30.00 | 5 min", "30.00"),
        ("30.00 | 5 min", "nan | 5 min"),
        ("30.00 | 5 min", "-3 | 5 min"),
        ("30.00 | 5 min", "30.00 | 5 weeks"),
        ("quantity = \"psnr\"", "quantity = \"pnsr\""),
        ("quantity = \"psnr\"", "quantity = \"masked_psnr\""),
        ("scenes = [", "mask = \"covisible\"\n        scenes = ["),
        ("values =", "value ="),
    ];
    for (from, to) in planted {
        assert!(Paper::parse(&good.replace(from, to)).is_err(), "{to} was accepted");
    }
}
