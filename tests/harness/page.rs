//! A live page, and requests to it, written as the bytes that a browser would send.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::process::{Child, Stdio};

use serde_json::Value;

use crate::{PATIENCE, TestRun};

/// A running page server.
#[derive(Debug)]
pub struct Page {
    /// `None` if somebody else has started it.
    server: Option<Child>,
    address: String,
    query: String,
}

impl Page {
    /// Starts a page from the test's folder, with these arguments. Its token is kept in that folder, too.
    pub fn over(run: &TestRun, arguments: &[&str]) -> Page {
        let mut command = run.program("goalward");
        command.env("XDG_STATE_HOME", run.path("state")).stdout(Stdio::piped());
        command.arg("page").args(arguments).args(["--port", "0"]);
        let mut server = command.spawn().unwrap();
        let mut line = String::new();
        BufReader::new(server.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let mut page = Page::at(line.split_whitespace().next().unwrap());
        page.server = Some(server);
        page
    }

    /// Returns the page at a URL, which somebody else has started.
    pub fn at(url: &str) -> Page {
        let (address, query) = url.strip_prefix("http://").unwrap().split_once("/?").unwrap();
        Page { server: None, address: address.to_owned(), query: query.to_owned() }
    }

    /// The page's URL, with its token.
    pub fn url(&self) -> String {
        format!("http://{}/?{}", self.address, self.query)
    }

    /// Whether the page accepts connections.
    pub fn is_there(&self) -> bool {
        TcpStream::connect(&self.address).is_ok()
    }

    /// The host and port of the page.
    pub fn address(&self) -> &str {
        &self.address
    }

    /// The query string of the page's URL, which has the token.
    pub fn query(&self) -> &str {
        &self.query
    }

    /// Returns an HTTP request as a browser sends it that has opened the page's URL.
    pub fn question(&self, method: &str, path: &str, host: &str) -> String {
        let sign = if path.contains('?') { '&' } else { '?' };
        Page::question_of_a_stranger(method, &format!("{path}{sign}{}", self.query), host)
    }

    /// Returns an HTTP request as a browser sends it that does not know the token.
    pub fn question_of_a_stranger(method: &str, path: &str, host: &str) -> String {
        format!("{method} {path} HTTP/1.1\r\nhost: {host}\r\nconnection: close\r\n\r\n")
    }

    /// Sends a request; returns the stream of the response.
    pub fn send(&self, question: &str) -> TcpStream {
        let port = self.address.rsplit_once(':').unwrap().1;
        let mut stream = TcpStream::connect(format!("127.0.0.1:{port}")).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        stream.write_all(question.as_bytes()).unwrap();
        stream
    }

    /// Sends a request; returns the response's status and body.
    pub fn answer(&self, question: &str) -> (u16, String) {
        let mut text = String::new();
        self.send(question).read_to_string(&mut text).unwrap();
        let (head, body) = text.split_once("\r\n\r\n").unwrap();
        (head.split(' ').nth(1).unwrap().parse().unwrap(), body.to_owned())
    }

    /// Sends a GET request with the page's own address as host; returns the response's status and body.
    pub fn get(&self, path: &str) -> (u16, String) {
        self.answer(&self.question("GET", path, &self.address))
    }

    /// Sends a GET request that must succeed; returns the body's bytes.
    pub fn bytes(&self, path: &str) -> Vec<u8> {
        let mut bytes = Vec::new();
        self.send(&self.question("GET", path, &self.address)).read_to_end(&mut bytes).unwrap();
        assert!(bytes.starts_with(b"HTTP/1.1 200 "), "{}", String::from_utf8_lossy(&bytes));
        let end = b"\r\n\r\n";
        let body = bytes.windows(end.len()).position(|part| part == end).unwrap();
        bytes.split_off(body + end.len())
    }

    /// Sends a GET request that must succeed; returns the body as JSON.
    pub fn json(&self, path: &str) -> Value {
        let (status, body) = self.get(path);
        assert_eq!(status, 200, "{path}: {body}");
        serde_json::from_str(&body).unwrap()
    }

    /// Sends a request that must be refused with a status; returns the error line.
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
