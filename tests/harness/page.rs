//! A live page that listens, and questions to it, written as the bytes that a browser would send.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::process::{Child, Stdio};

use serde_json::Value;

use crate::{PATIENCE, TestRun};

/// A page that listens.
#[derive(Debug)]
pub struct Page {
    /// None for one that somebody else has started.
    server: Option<Child>,
    address: String,
    query: String,
}

impl Page {
    /// Starts one over folders in a test's folder.
    pub fn over(run: &TestRun, arguments: &[&str]) -> Page {
        let mut command = run.program("goalward");
        command.arg("page").args(arguments).args(["--port", "0"]).stdout(Stdio::piped());
        let mut server = command.spawn().unwrap();
        let mut line = String::new();
        BufReader::new(server.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let address = line.split_whitespace().next().unwrap().strip_prefix("http://").unwrap();
        let (address, query) = address.split_once("/?").unwrap_or((address, ""));
        Page { server: Some(server), address: address.to_owned(), query: query.to_owned() }
    }

    /// The one at an address, which somebody else has started.
    pub fn at(address: &str) -> Page {
        Page { server: None, address: address.to_owned(), query: String::new() }
    }

    /// Whether anybody listens.
    pub fn is_there(&self) -> bool {
        TcpStream::connect(&self.address).is_ok()
    }

    /// Where a browser finds it.
    pub fn address(&self) -> &str {
        &self.address
    }

    /// What its address has behind the question mark.
    pub fn query(&self) -> &str {
        &self.query
    }

    /// The bytes of a question as a browser sends it.
    pub fn question(&self, method: &str, path: &str, host: &str) -> String {
        format!("{method} {path} HTTP/1.1\r\nhost: {host}\r\nconnection: close\r\n\r\n")
    }

    /// Sends a question.
    pub fn send(&self, question: &str) -> TcpStream {
        let port = self.address.rsplit_once(':').unwrap().1;
        let mut stream = TcpStream::connect(format!("127.0.0.1:{port}")).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        stream.write_all(question.as_bytes()).unwrap();
        stream
    }

    /// Status and body of an answer.
    pub fn answer(&self, question: &str) -> (u16, String) {
        let mut text = String::new();
        self.send(question).read_to_string(&mut text).unwrap();
        let (head, body) = text.split_once("\r\n\r\n").unwrap();
        (head.split(' ').nth(1).unwrap().parse().unwrap(), body.to_owned())
    }

    /// The same to a question of the page itself.
    pub fn get(&self, path: &str) -> (u16, String) {
        self.answer(&self.question("GET", path, &self.address))
    }

    /// The bytes of an answer that is all well.
    pub fn bytes(&self, path: &str) -> Vec<u8> {
        let mut bytes = Vec::new();
        self.send(&self.question("GET", path, &self.address)).read_to_end(&mut bytes).unwrap();
        assert!(bytes.starts_with(b"HTTP/1.1 200 "), "{}", String::from_utf8_lossy(&bytes));
        let end = b"\r\n\r\n";
        let body = bytes.windows(end.len()).position(|part| part == end).unwrap();
        bytes.split_off(body + end.len())
    }

    /// An answer of the page to itself.
    pub fn json(&self, path: &str) -> Value {
        let (status, body) = self.get(path);
        assert_eq!(status, 200, "{path}: {body}");
        serde_json::from_str(&body).unwrap()
    }

    /// The line of a refusal.
    pub fn refusal(&self, expected: u16, question: &str) -> String {
        let (status, body) = self.answer(question);
        assert_eq!(status, expected, "{question}: {body}");
        let error: Value = serde_json::from_str(&body).unwrap();
        let line = error["error"].as_str().unwrap().to_owned();
        assert!(!line.contains('\n'), "{line}");
        line
    }
}

impl Drop for Page {
    fn drop(&mut self) {
        if let Some(server) = &mut self.server {
            server.kill().unwrap();
            server.wait().unwrap();
        }
    }
}
