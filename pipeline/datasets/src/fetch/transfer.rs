//! One download over HTTP: resumed, retried, and compared with the manifest.

use std::io::{Read as _, Write as _};
use std::path::{Path, PathBuf};
use std::time::Duration;

use engine::{Failure, FailureKind};
use serde::{Deserialize, Serialize};
use ureq::http::{Response, StatusCode, header};
use ureq::tls::{RootCerts, TlsConfig};
use ureq::{Agent, Body};

use super::Event;
use crate::files::{digest, io, world};
use crate::manifest::Archive;

/// Attempts without a new byte before a download fails.
const ATTEMPTS: u32 = 5;
/// The first pause between attempts; each one doubles it.
const PAUSE: Duration = Duration::from_millis(250);
/// Bytes between two reports of progress.
const BLOCK: usize = 1 << 18;

/// The identity of the file of which an unfinished download is a part.
#[derive(Debug, Default, PartialEq, Serialize, Deserialize)]
struct Stamp {
    url: String,
    total: Option<u64>,
    /// The server's name for this version of the file.
    version: Option<String>,
}

/// The end of an attempt.
enum Ended {
    Complete,
    /// The connection was cut, or the server is busy.
    Again(String),
}

/// Downloads into `folder`, under the lock of the archive; returns the finished file, its size and its SHA-256.
pub(super) fn download(
    archive: &Archive,
    folder: &Path,
    silence: Duration,
    report: &dyn Fn(Event),
) -> Result<(PathBuf, u64, String), Failure> {
    let finished = folder.join(archive.stored_as());
    let part = folder.join(format!("{}.part", archive.stored_as()));
    if !finished.is_file() {
        let agent = agent(archive, silence);
        let (mut failed, mut before) = (0, length(&part));
        while let Ended::Again(why) = attempt(&agent, archive, &part, report)? {
            let now = length(&part);
            failed = if now > before { 1 } else { failed + 1 };
            before = now;
            if failed >= ATTEMPTS {
                let hint = "run the same command again: it continues where this download ended";
                return Err(world(format!("{why} ({failed} attempts without a new byte)")).hint(hint));
            }
            report(Event::Retry(why));
            std::thread::sleep(PAUSE * 2_u32.pow(failed - 1));
        }
        fs_err::rename(&part, &finished).map_err(io)?;
        let _ = fs_err::remove_file(stamp_path(&part)); // describes a part that no longer exists
    }
    let (size, sha256) = digest(&finished)?;
    check(archive, &finished, size, &sha256)?;
    Ok((finished, size, sha256))
}

/// An HTTP client with the proxy of the environment and the certificates of the system. A server that sends nothing for
/// `silence` has hung: its connection is cut.
fn agent(archive: &Archive, silence: Duration) -> Agent {
    let tls = TlsConfig::builder().root_certs(RootCerts::PlatformVerifier).build();
    let config = Agent::config_builder()
        .tls_config(tls)
        .https_only(archive.url.starts_with("https://"))
        .http_status_as_error(false)
        .timeout_connect(Some(silence))
        .timeout_recv_response(Some(silence))
        .timeout_per_read(Some(silence)) // the whole body may take hours
        .user_agent(concat!("pipeline/", env!("CARGO_PKG_VERSION")));
    config.build().into()
}

fn length(path: &Path) -> u64 {
    std::fs::metadata(path).map_or(0, |found| found.len())
}

fn stamp_path(part: &Path) -> PathBuf {
    part.with_extension("part.json")
}

fn stamp_of(part: &Path) -> Stamp {
    let text = std::fs::read(stamp_path(part)).unwrap_or_default();
    serde_json::from_slice(&text).unwrap_or_default() // an unreadable stamp fits no address
}

/// Requests the missing bytes, and appends the response.
fn attempt(agent: &Agent, archive: &Archive, part: &Path, report: &dyn Fn(Event)) -> Result<Ended, Failure> {
    let stamp = stamp_of(part);
    let have = if stamp.url == archive.url { length(part) } else { 0 };
    let mut request = agent.get(&archive.url).header(header::ACCEPT_ENCODING, "identity");
    if have > 0 {
        request = request.header(header::RANGE, format!("bytes={have}-"));
        if let Some(version) = &stamp.version {
            request = request.header(header::IF_RANGE, version);
        }
    }
    let response = match request.call() {
        Ok(response) => response,
        Err(error) if is_final(&error) => return Err(world(error.to_string()).hint("check the address and the proxy")),
        Err(error) => return Ok(Ended::Again(error.to_string())),
    };
    match response.status() {
        StatusCode::OK => receive(response, archive, part, 0, report),
        StatusCode::PARTIAL_CONTENT if is_next(&response, have, &stamp) => {
            receive(response, archive, part, have, report)
        }
        StatusCode::RANGE_NOT_SATISFIABLE if have > 0 && range_total(&response) == Some(have) => Ok(Ended::Complete),
        StatusCode::PARTIAL_CONTENT | StatusCode::RANGE_NOT_SATISFIABLE => {
            fs_err::File::create(part).map_err(io)?; // the server has another file now
            Ok(Ended::Again("the server's file has changed: starting again".into()))
        }
        status if status.is_server_error() || status == StatusCode::TOO_MANY_REQUESTS => {
            Ok(Ended::Again(format!("the server answers {status}")))
        }
        status => {
            let failure = Failure::new(FailureKind::MissingData, format!("the server answers {status}"));
            Err(failure.hint("the address may have changed: see the homepage of the data set"))
        }
    }
}

/// Whether another attempt would end the same way.
fn is_final(error: &ureq::Error) -> bool {
    use ureq::Error::{BadUri, RequireHttpsOnly, TooManyRedirects};
    matches!(error, BadUri(_) | RequireHttpsOnly(_) | TooManyRedirects | ureq::Error::Tls(_))
}

fn text(response: &Response<Body>, name: header::HeaderName) -> Option<&str> {
    response.headers().get(name)?.to_str().ok()
}

/// The size of the whole file in `Content-Range: bytes FROM-TO/TOTAL`.
fn range_total(response: &Response<Body>) -> Option<u64> {
    text(response, header::CONTENT_RANGE)?.rsplit_once('/')?.1.parse().ok()
}

/// Whether a partial response continues the unfinished file.
fn is_next(response: &Response<Body>, have: u64, stamp: &Stamp) -> bool {
    let from = text(response, header::CONTENT_RANGE)
        .and_then(|range| range.strip_prefix("bytes ")?.split_once('-')?.0.parse::<u64>().ok());
    from == Some(have) && (stamp.total.is_none() || range_total(response) == stamp.total)
}

/// Appends the body at `from`, which is 0 for a whole file.
fn receive(
    response: Response<Body>,
    archive: &Archive,
    part: &Path,
    from: u64,
    report: &dyn Fn(Event),
) -> Result<Ended, Failure> {
    let is_page = text(&response, header::CONTENT_TYPE).is_some_and(|kind| kind.starts_with("text/html"));
    if is_page {
        let failure = Failure::new(FailureKind::MissingData, "the server sent a web page instead of the file");
        return Err(failure.hint("download it with a browser, and put it where the manifest says"));
    }
    let length = text(&response, header::CONTENT_LENGTH).and_then(|length| length.parse::<u64>().ok());
    let total = length.map(|length| from + length);
    if let (Some(stated), Some(total)) = (archive.size, total)
        && stated != total
    {
        let message = format!("the server has {total} bytes, the manifest states {stated}");
        return Err(world(message).hint("the file was replaced: compare it with the homepage of the data set"));
    }
    // Weak entity tags permit differences in bytes.
    let version = text(&response, header::ETAG).filter(|etag| !etag.starts_with("W/"));
    let version = version.or(text(&response, header::LAST_MODIFIED)).map(str::to_owned);
    let stamp = serde_json::to_vec(&Stamp { url: archive.url.clone(), total, version });
    fs_err::write(stamp_path(part), stamp.map_err(|error| world(error.to_string()))?).map_err(io)?;
    let mut file = fs_err::OpenOptions::new().create(true).append(from > 0).write(true).truncate(from == 0).open(part);
    let file = file.as_mut().map_err(|error| world(error.to_string()))?;
    let (mut body, mut block, mut have) = (response.into_body().into_reader(), vec![0; BLOCK], from);
    loop {
        match body.read(&mut block) {
            Ok(0) if total.is_none_or(|total| have == total) => return Ok(Ended::Complete),
            Ok(0) => return Ok(Ended::Again(format!("the connection was cut after {have} bytes"))),
            Ok(count) => {
                file.write_all(&block[..count]).map_err(io)?;
                have += count as u64;
                report(Event::Bytes(have, total));
            }
            Err(error) => return Ok(Ended::Again(format!("the connection was cut after {have} bytes ({error})"))),
        }
    }
}

/// Compares a finished file with the manifest; a wrong one is removed.
fn check(archive: &Archive, path: &Path, size: u64, sha256: &str) -> Result<(), Failure> {
    let has_size = archive.size.is_none_or(|stated| stated == size);
    if has_size && archive.fits(sha256) {
        return Ok(());
    }
    fs_err::remove_file(path).map_err(io)?;
    let stated = archive.sha256.as_deref().unwrap_or("unknown");
    let message = format!(
        "the download has {size} bytes and the SHA-256 {sha256}, the manifest states {} bytes and {stated}",
        archive.size.map_or("any number of".into(), |size| size.to_string())
    );
    let hint =
        "the file was damaged on the way or replaced at its source; it is removed: fetch again, or ask its authors";
    Err(world(message).hint(hint))
}
