//! CSV files of all runs and of all evaluated images, unrounded.

use metric_evaluation::Score;

use crate::column::Column;
use crate::report::Report;

/// One line per run: protocol, method, scene and seed, all values (empty if missing), the outcome, and the action keys.
pub(crate) fn runs(report: &Report) -> anyhow::Result<String> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    let ports = ["model", "renders", "metrics"];
    let lead = ["protocol", "protocol_hash", "method", "scene", "seed"].into_iter().map(String::from);
    let values = Column::all().map(|column| column.key().to_owned());
    let trail = ["outcome".to_owned()].into_iter().chain(ports.map(|port| format!("{port}_key")));
    writer.write_record(lead.chain(values).chain(trail))?;
    for run in &report.runs {
        let protocol = report.group_of(run).map(|group| group.name.clone()).unwrap_or_default();
        let hash = run.protocol.as_ref().map(scene::Protocol::hash).unwrap_or_default();
        let lead = [protocol, hash, run.row.clone(), run.scene.clone(), run.seed.clone()].into_iter();
        let values = Column::all().map(|column| {
            let value = run.figures.get(&column).and_then(Score::value).filter(|value| value.is_finite());
            value.map(|value| value.to_string()).unwrap_or_default()
        });
        let keys = ports.map(|port| run.jobs.get(port).map(|job| job.key.clone()).unwrap_or_default());
        writer.write_record(lead.chain(values).chain([run.outcome().to_owned()]).chain(keys))?;
    }
    Ok(String::from_utf8(writer.into_inner()?)?)
}

/// One line per evaluated image: protocol, method, scene, seed, view, time and PSNR.
pub(crate) fn frames(report: &Report) -> anyhow::Result<String> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    writer.write_record(["protocol", "method", "scene", "seed", "view", "time_secs", "psnr"])?;
    for run in &report.runs {
        let protocol = report.group_of(run).map(|group| group.name.as_str()).unwrap_or_default();
        for frame in &run.frames {
            let time = frame.time_secs.map(|secs| secs.to_string()).unwrap_or_default();
            let lead = [protocol, &run.row, &run.scene, &run.seed, &frame.name];
            writer.write_record(lead.into_iter().chain([time.as_str(), &frame.psnr.to_string()]))?;
        }
    }
    Ok(String::from_utf8(writer.into_inner()?)?)
}
