//! The HTML page is well formed and self-contained, and every link has a target.

use std::collections::BTreeSet;

use super::content::document;
use super::formats::awkward;
use super::*;
use crate::document::Block;
use crate::html;

fn page(report: &Report) -> String {
    html::html(&document(report))
}

/// The values of an attribute, in order.
fn attributes<'a>(page: &'a str, name: &str) -> Vec<&'a str> {
    let start = format!(" {name}=\"");
    page.match_indices(&start).filter_map(|(at, found)| page[at + found.len()..].split('"').next()).collect()
}

/// Dead links, external resources, scripts and repeated ids of a page.
pub(super) fn problems(page: &str) -> Vec<String> {
    let ids: BTreeSet<&str> = attributes(page, "id").into_iter().collect();
    let dead = attributes(page, "href").into_iter().filter(|to| {
        let place = to.strip_prefix('#');
        !place.is_some_and(|place| ids.contains(place))
    });
    let foreign = ["src", "srcset", "xlink:href", "data", "poster", "action"];
    let loaded = foreign.iter().flat_map(|name| attributes(page, name)).filter(|from| !from.starts_with("data:"));
    let twice = attributes(page, "id").len() - ids.len();
    let style = page.split("<style>").nth(1).and_then(|rest| rest.split("</style>").next()).unwrap_or_default();
    let in_style = ["@import", "url("].into_iter().filter(|word| style.contains(word));
    let elements = ["<script", "<link", "<iframe", "<object", "<embed"].into_iter().filter(|tag| page.contains(tag));
    dead.map(|to| format!("dead link {to}"))
        .chain(loaded.map(|from| format!("loads {from}")))
        .chain(in_style.map(|word| format!("{word} in the style")))
        .chain(elements.map(|tag| format!("element {tag}")))
        .chain((twice > 0).then(|| format!("{twice} repeated ids")))
        .collect()
}

#[test]
fn the_page_is_self_contained_and_links_resolve() {
    let page = page(&awkward());
    assert_eq!(problems(&page), Vec::<String>::new());
    assert!(attributes(&page, "href").iter().filter(|to| to.starts_with("#run-")).count() > 40, "numbers have links");
}

#[test]
fn results_come_before_verdicts_and_equal_reasons_share_a_row() {
    let small = two_by_two().into_iter().map(|run| Run { protocol: Some(protocol(200)), ..run });
    let document = document(&report(small.collect()));
    let ids: Vec<&str> = document.sections.iter().map(|section| section.id).collect();
    assert_eq!(ids[..3], ["summary", "results", "published"]);
    let Some(Block::Table(verdicts)) = document.sections[2].blocks.first() else { panic!("no table of verdicts") };
    let reasons: Vec<&str> = verdicts.rows.iter().map(|row| row[3].text.as_str()).collect();
    let distinct: BTreeSet<&str> = reasons.iter().copied().collect();
    assert_eq!(distinct.len(), reasons.len(), "{reasons:?}");
    let n_sources: usize = report(two_by_two()).groups[0].claims.iter().map(|table| table.columns.len()).sum();
    assert!(reasons.len() < n_sources, "{} rows for {n_sources} sources", reasons.len());
}

#[test]
fn wordy_tables_label_their_cells_for_narrow_screens() {
    let page = page(&awkward());
    let failed = page.split("Failed runs</span>").nth(1).expect("the table");
    assert_eq!(attributes(failed.split("</table>").next().expect("its text"), "data-label")[..2], ["job", "message"]);
    let before = page.split("Failed runs</span>").next().expect("the text before");
    assert!(before.rfind("class=\"wordy\"") > before.rfind("</table>"), "the table of failures is not wordy");
}

#[test]
fn planted_faults_of_a_page_are_noticed() {
    let good = page(&awkward());
    let planted = [
        ("</main>", "<img src=\"https://example.org/x.png\"></main>"),
        ("</main>", "<a href=\"#nowhere\">x</a></main>"),
        ("</main>", "<a href=\"other.html\">x</a></main>"),
        ("</main>", "<script>1</script></main>"),
        ("<style>", "<style>@import \"x.css\";"),
        ("</main>", "<p id=\"runs\"></p></main>"),
    ];
    for (from, to) in planted {
        assert_eq!(problems(&good.replacen(from, to, 1)).len(), 1, "{to} was not noticed");
    }
}

#[test]
fn numbers_link_to_run_job_key_and_command() {
    let arguments = ["-s", "axes.note = ['it']", "--replicates", "2"].map(String::from).to_vec();
    let recipe = "recipes/x.toml".into();
    let params = TableGenerationParams { recipe, arguments, ..TableGenerationParams::default() };
    let document = crate::sections::document(&report(two_by_two()), Vec::new(), &params).expect("a document");
    let page = html::html(&document);
    // 40.6 dB is the mean over two seeds of deformable4dgs on bouncingballs.
    let cell = page.split("<td").find(|cell| cell.contains(">40.60 ± 0.14<")).expect("the cell");
    let target = attributes(cell, "href")[0].trim_start_matches('#').to_owned();
    assert!(attributes(cell, "title")[0].contains("train/bouncingballs/deformable4dgs/0 · key 0123456789ab"), "{cell}");
    let row = page.split("<tr>").find(|row| row.contains(&format!("id=\"{target}\""))).expect("the row of the run");
    let command_row = row.split("<tr class=\"below\">").nth(1).expect("a row with the command alone");
    assert!(command_row.contains("<span>-s</span> <span>"), "a line break may divide an argument: {command_row}");
    let row = row.replace("<span>", "").replace("</span>", "");
    let command = "pipeline run recipes/x.toml -s 'axes.note = ['\\''it'\\'']' --replicates 2 --only \
                   train/bouncingballs/deformable4dgs/0";
    for part in ["deformable4dgs", "bouncingballs", "0123456789ab", ">12.0<", command] {
        assert!(row.contains(part), "{part} is missing: {row}");
    }
}

#[test]
fn numbers_of_every_section_link_to_runs() {
    let page = page(&awkward());
    for section in ["pareto", "budgets", "costs"] {
        let start = page.find(&format!("<section id=\"{section}\">")).expect("the section");
        let text = page[start..].split("</section>").next().expect("its text");
        let cells = text.split("<td").skip(1).map(|cell| cell.split("</td>").next().unwrap_or_default());
        let numbers: Vec<&str> =
            cells.filter(|cell| cell.ends_with(|c: char| c.is_ascii_digit()) || cell.contains("</a>")).collect();
        assert!(numbers.len() >= 3, "{section}: {numbers:?}");
        assert!(numbers.iter().all(|cell| cell.contains("href=\"#run-")), "{section}: {numbers:?}");
    }
}

#[test]
fn texts_between_backticks_are_code_on_the_page() {
    let page = page(&awkward());
    let note = "<code>pipeline show RECIPE JOB</code> prints a job's folder";
    assert!(page.contains(note) && !page.contains('`'), "{page}");
    assert!(page.contains("add the <code>--store</code> of the run"), "commands do not name it: {page}");
}

#[test]
fn only_the_best_of_two_is_emphasised() {
    let of = |methods: &[&str]| {
        let runs = methods.iter().zip([30.0, 31.0, 32.0]).map(|(method, psnr)| run("trex", method, 0, psnr));
        page(&report(runs.collect()))
    };
    let two = of(&["static3dgs", "mcgs"]);
    assert!(two.contains("class=\"best\"") && !two.contains("class=\"second\""), "{two}");
    assert!(two.contains("Bold: the best of its column.</p>"), "{two}");
    let three = of(&["static3dgs", "mcgs", "scgs"]);
    assert!(three.contains("class=\"second\"") && three.contains("class=\"third\""), "{three}");
    assert!(three.contains("underline the second and print the third in italics.</p>"), "{three}");
}

#[test]
fn elements_are_closed_and_text_is_escaped() {
    let page = page(&awkward());
    let elements =
        ["html", "head", "body", "main", "section", "table", "thead", "tbody", "tr", "td", "th", "p", "svg", "g", "a"];
    for element in elements {
        let opened = page.matches(&format!("<{element}>")).count() + page.matches(&format!("<{element} ")).count();
        assert_eq!(opened, page.matches(&format!("</{element}>")).count(), "{element}");
    }
    assert!(page.contains("a_b &amp; &lt;c&gt;|d") && !page.contains("<c>"));
}

#[test]
fn tables_have_captions_and_heading_scopes() {
    let page = page(&awkward());
    assert_eq!(page.matches("<table").count(), page.matches("<caption>").count());
    let headings = page.matches("<th ").count();
    let body = page.split("</style>").nth(1).expect("a body");
    assert_eq!(headings, body.matches(" scope=\"").count(), "a heading without a scope");
    assert_eq!(
        page.matches("<svg ").count(),
        page.matches("role=\"img\"").count() + page.matches("aria-hidden").count()
    );
}

#[test]
fn cells_never_contain_nan_or_infinity() {
    let mut runs = two_by_two();
    runs[0].figures.insert(Column::PSNR, Score::Value(f64::NAN));
    runs[1].frames[0].psnr = f64::NAN;
    runs[2].phases.insert("blend".into(), f64::INFINITY);
    let refused = Report::new(runs.clone(), &[], &TableGenerationParams::default());
    assert!(refused.check().is_err(), "an infinite phase was accepted");
    runs[2].phases.remove("blend");
    let page = page(&Report::new(runs, &[], &TableGenerationParams::default()));
    let cells: Vec<&str> = page.split("<td").skip(1).filter_map(|cell| cell.split("</td>").next()).collect();
    assert!(cells.len() > 100);
    assert!(cells.iter().all(|cell| !cell.contains("NaN") && !cell.contains("inf")), "{cells:?}");
}
