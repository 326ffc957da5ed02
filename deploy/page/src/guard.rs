//! Admits requests with the token, so that no other user of the machine is answered. A page that listens on a loopback
//! address admits only those to this machine's own names. Requests by other sites in the same browser are refused,
//! whatever name they use for this address (DNS rebinding).

use std::net::IpAddr;

use axum::http::{HeaderMap, Uri, header};

/// What decides whether a request is admitted.
#[derive(Clone, Debug)]
pub(crate) struct Guard {
    /// The address that the page listens on.
    pub(crate) host: IpAddr,
    /// The token that requests about runs need.
    pub(crate) token: String,
}

/// Prefix of the paths of requests about runs. Only these need the token: a browser requests the page's files without
/// it, and they are not secret.
const OF_RUNS: &str = "/api/";

/// Names by which a browser reaches its own machine.
const OWN_NAMES: [&str; 3] = ["127.0.0.1", "localhost", "[::1]"];

impl Guard {
    /// Admits a request.
    ///
    /// # Errors
    /// Says why the request is refused.
    pub(crate) fn admit(&self, uri: &Uri, headers: &HeaderMap) -> Result<(), String> {
        let text = |name| headers.get(name).and_then(|value| value.to_str().ok());
        let host = text(header::HOST).unwrap_or_default();
        if self.host.is_loopback() && !self.is_own(without_port(host)) {
            return Err(format!(
                "expected this machine's own name in the address, such as 127.0.0.1, found {}",
                shown(host)
            ));
        }
        let is_given = given_token(uri).is_some_and(|given| is_same(given, &self.token));
        if uri.path().starts_with(OF_RUNS) && !is_given {
            return Err(
                "expected the token of the address that goalward printed: its ?token=…".to_owned()
            );
        }
        let origin = text(header::ORIGIN);
        let own = |origin: &str| origin.split_once("://").is_some_and(|(_, name)| name == host);
        let site = headers.get("sec-fetch-site").and_then(|value| value.to_str().ok());
        // Another site may link to the page, but not load anything from it. Frames are navigations too; the content
        // security policy keeps them from showing the page.
        let leads_here = headers.get("sec-fetch-mode").is_some_and(|mode| mode == "navigate");
        let is_loaded_elsewhere = matches!(site, Some("cross-site" | "same-site")) && !leads_here;
        if origin.is_some_and(|origin| !own(origin)) || is_loaded_elsewhere {
            let found = origin.map_or_else(|| "another site".to_owned(), shown);
            return Err(format!("expected a question from this page, found one from {found}"));
        }
        Ok(())
    }

    fn is_own(&self, name: &str) -> bool {
        OWN_NAMES.contains(&name) || name.parse::<IpAddr>() == Ok(self.host)
    }
}

/// Returns a header's value for a message, cut off where it gets long.
fn shown(value: &str) -> String {
    format!("{:?}", value.chars().take(80).collect::<String>())
}

fn given_token(uri: &Uri) -> Option<&str> {
    uri.query()?.split('&').find_map(|pair| pair.strip_prefix("token="))
}

/// Compares in a time that does not depend on where the two differ.
fn is_same(given: &str, token: &str) -> bool {
    let differing =
        given.bytes().zip(token.bytes()).fold(0, |all, (one, other)| all | (one ^ other));
    given.len() == token.len() && differing == 0
}

fn without_port(host: &str) -> &str {
    let is_port = |text: &str| text.bytes().all(|letter| letter.is_ascii_digit());
    host.rsplit_once(':').filter(|(_, port)| is_port(port)).map_or(host, |(name, _)| name)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The address that a page listens on unless another is named.
    const HERE: &str = "127.0.0.1";

    /// Whether a page that listens on `listens` admits a request.
    fn admitted(listens: &str, path: &str, headers: &[(&'static str, &str)]) -> bool {
        let headers = headers
            .iter()
            .map(|(name, value)| (header::HeaderName::from_static(name), value.parse().unwrap()));
        let guard = Guard { host: listens.parse().unwrap(), token: "abc".to_owned() };
        guard.admit(&path.parse().unwrap(), &headers.collect()).is_ok()
    }

    #[test]
    fn this_machine_is_answered_by_its_own_names_alone() {
        for host in ["127.0.0.1:7878", "localhost:7878", "[::1]:7878", "localhost"] {
            assert!(admitted(HERE, "/", &[("host", host)]), "{host}");
        }
        for host in ["evil.example:7878", "127.0.0.1.evil.example", "", "[::2]:7878", "::1"] {
            assert!(!admitted(HERE, "/", &[("host", host)]), "{host}");
        }
        assert!(!admitted(HERE, "/", &[]));
    }

    #[test]
    fn the_address_it_listens_on_is_a_name_of_its_own() {
        let asked = |listens, name| admitted(listens, "/api/runs?token=abc", &[("host", name)]);
        assert!(asked("127.0.0.2", "127.0.0.2:7878") && asked("127.0.0.2", "localhost:7878"));
        assert!(!asked("127.0.0.2", "127.0.0.3:7878") && !asked(HERE, "127.0.0.2:7878"));
    }

    #[test]
    fn a_token_is_asked_for_on_every_address() {
        for (listens, name) in [(HERE, "127.0.0.1:7878"), ("0.0.0.0", "10.0.0.5:7878")] {
            let host = ("host", name);
            assert!(admitted(listens, "/api/runs?token=abc", &[host]));
            assert!(admitted(listens, "/api/runs?from=3&token=abc", &[host]));
            for query in ["", "?token=", "?token=abd", "?token=abcd", "?nottoken=abc"] {
                assert!(!admitted(listens, &format!("/api/runs{query}"), &[host]), "{query}");
            }
            for path in ["/", "/?token=abc", "/app.js", "/style.css"] {
                assert!(admitted(listens, path, &[host]), "{path}");
                let foreign = ("origin", "http://evil.example");
                assert!(!admitted(listens, path, &[host, foreign]), "{path}");
            }
        }
    }

    #[test]
    fn other_sites_are_refused() {
        let host = ("host", "localhost:7878");
        assert!(admitted(HERE, "/", &[host, ("origin", "http://localhost:7878")]));
        for origin in ["http://evil.example", "null", "http://localhost:80"] {
            assert!(!admitted(HERE, "/", &[host, ("origin", origin)]), "{origin}");
        }
        let site = ("sec-fetch-site", "cross-site");
        assert!(!admitted(HERE, "/", &[host, site, ("sec-fetch-mode", "no-cors")]));
        assert!(admitted(HERE, "/", &[host, site, ("sec-fetch-mode", "navigate")]));
        assert!(admitted(HERE, "/", &[host, ("sec-fetch-site", "same-origin")]));
    }
}
