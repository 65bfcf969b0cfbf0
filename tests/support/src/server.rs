//! An HTTP server on this machine for tests of downloads: ranges, cut connections, redirects, proxies.

use std::collections::BTreeMap;
use std::io::{BufRead as _, BufReader, Write as _};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// The request of a client.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Asked {
    /// The path of the address.
    pub path: String,
    /// The headers, with names in lower case.
    pub headers: BTreeMap<String, String>,
}

impl Asked {
    /// The first byte that a range requests.
    pub fn from_byte(&self) -> Option<usize> {
        self.headers.get("range")?.strip_prefix("bytes=")?.strip_suffix('-')?.parse().ok()
    }
}

/// How the server answers one request.
#[derive(Clone, Debug)]
pub struct Answer {
    /// The status with its words, e.g. `200 OK`.
    pub status: String,
    /// Header lines.
    pub headers: Vec<String>,
    /// The whole body.
    pub body: Vec<u8>,
    /// Ends the connection after this many bytes of the body.
    pub cut_after: Option<usize>,
    /// Waits this long after each 64 KiB.
    pub pause: Duration,
}

impl Answer {
    /// An answer without a body.
    pub fn status(status: &str) -> Self {
        Self { status: status.into(), headers: Vec::new(), body: Vec::new(), cut_after: None, pause: Duration::ZERO }
    }

    /// The whole file.
    pub fn whole(file: &[u8]) -> Self {
        Self { body: file.to_vec(), ..Self::status("200 OK") }
    }

    /// The file from the requested byte, as the version `etag`; the whole file if the request is about
    /// another version.
    pub fn ranged(asked: &Asked, file: &[u8], etag: &str) -> Self {
        let tag = format!("ETag: \"{etag}\"");
        let is_same = asked.headers.get("if-range").is_none_or(|stated| *stated == format!("\"{etag}\""));
        match asked.from_byte().filter(|_| is_same) {
            None => Self { headers: vec![tag], ..Self::whole(file) },
            Some(from) if from >= file.len() => {
                let range = format!("Content-Range: bytes */{}", file.len());
                Self { headers: vec![tag, range], ..Self::status("416 Range Not Satisfiable") }
            }
            Some(from) => {
                let range = format!("Content-Range: bytes {from}-{}/{}", file.len() - 1, file.len());
                Self { headers: vec![tag, range], body: file[from..].to_vec(), ..Self::status("206 Partial Content") }
            }
        }
    }
}

/// A running server; it ends with the process.
pub struct Server {
    address: SocketAddr,
    asked: Arc<Mutex<Vec<Asked>>>,
}

impl Server {
    /// Starts a server that answers every request with `answer`, which also gets the number of earlier requests.
    pub fn start(answer: impl Fn(&Asked, usize) -> Answer + Send + Sync + 'static) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a local port is free");
        let address = listener.local_addr().expect("the listener is bound");
        let asked: Arc<Mutex<Vec<Asked>>> = Arc::default();
        let (log, answer) = (asked.clone(), Arc::new(answer));
        std::thread::spawn(move || {
            for stream in listener.incoming().flatten() {
                let (log, answer) = (log.clone(), answer.clone());
                std::thread::spawn(move || serve(stream, &log, &*answer));
            }
        });
        Self { address, asked }
    }

    /// The address of a path.
    pub fn url(&self, path: &str) -> String {
        format!("http://{}{path}", self.address)
    }

    /// All requests so far.
    pub fn asked(&self) -> Vec<Asked> {
        self.asked.lock().expect("no thread panics").clone()
    }
}

/// Answers one request and closes the connection. A client may go away at any time, so errors of the connection are
/// expected.
fn serve(stream: TcpStream, log: &Mutex<Vec<Asked>>, answer: &dyn Fn(&Asked, usize) -> Answer) {
    let Ok(reading) = stream.try_clone() else { return };
    let (mut reader, mut writer) = (BufReader::new(reading), stream);
    let Some(mut asked) = read_request(&mut reader) else { return };
    // A proxy opens a tunnel, which ends here as well.
    if asked.path.is_empty() {
        let _ = writer.write_all(b"HTTP/1.1 200 Connection established\r\n\r\n");
        match read_request(&mut reader) {
            Some(inner) => asked = inner,
            None => return,
        }
    }
    let count = {
        let mut log = log.lock().expect("no thread panics");
        log.push(asked.clone());
        log.len() - 1
    };
    let answer = answer(&asked, count);
    let headers: String = answer.headers.iter().map(|line| format!("{line}\r\n")).collect();
    let head = format!(
        "HTTP/1.1 {}\r\n{headers}Content-Length: {}\r\nConnection: close\r\n\r\n",
        answer.status,
        answer.body.len()
    );
    let end = answer.cut_after.unwrap_or(usize::MAX).min(answer.body.len());
    let _ = writer.write_all(head.as_bytes());
    for block in answer.body[..end].chunks(1 << 16) {
        if writer.write_all(block).and_then(|()| writer.flush()).is_err() {
            return;
        }
        std::thread::sleep(answer.pause);
    }
    let _ = writer.shutdown(std::net::Shutdown::Both);
}

/// The request line and headers; the path is empty for a tunnel.
fn read_request(reader: &mut BufReader<TcpStream>) -> Option<Asked> {
    let mut line = String::new();
    reader.read_line(&mut line).ok().filter(|count| *count > 0)?;
    let mut words = line.split_whitespace();
    let (verb, target) = (words.next()?, words.next()?);
    // Proxies get the whole address.
    let path = match target.split_once("://") {
        Some((_, rest)) => rest.split_once('/').map_or("/".into(), |(_, path)| format!("/{path}")),
        None => target.to_owned(),
    };
    let mut headers = BTreeMap::new();
    loop {
        let mut line = String::new();
        reader.read_line(&mut line).ok()?;
        let Some((name, value)) = line.trim_end().split_once(':') else { break };
        headers.insert(name.to_lowercase(), value.trim().to_owned());
    }
    Some(Asked { path: if verb == "CONNECT" { String::new() } else { path }, headers })
}
