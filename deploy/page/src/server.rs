//! The server: its address, the admission of requests, the headers of responses, and events on changes of runs.

use std::net::{IpAddr, SocketAddr};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, Result};
use axum::Router;
use axum::extract::{Path, Request, State};
use axum::http::{HeaderValue, StatusCode, header};
use axum::middleware::{Next, from_fn_with_state, map_response};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use tokio::net::TcpListener;

use crate::guard::Guard;
use crate::programs::PagePrograms;
use crate::runs::Runs;
use crate::state::{Pages, Refused};
use crate::{api, assets, token};

/// Interval at which the runs are checked for changes while a browser listens to events.
const LOOK_EVERY: Duration = Duration::from_secs(1);

/// How long browsers that listen may still ask after the training has ended.
const LAST_QUESTIONS: Duration = Duration::from_millis(1500);

/// The content security policy: the page loads only its own files, and no site may show it in a frame.
const POLICY: &str = "default-src 'self'; img-src 'self' data: blob:; frame-ancestors 'none'; base-uri 'none'; \
                      form-action 'none'";

/// Where a page listens and what it shows.
pub struct Settings {
    /// Folders of runs, or folders that contain them, such as that of an experiment.
    pub folders: Vec<PathBuf>,
    /// The address to listen on.
    pub host: IpAddr,
    /// The port; 0 takes a free one.
    pub port: u16,
    /// The name by which other machines find this one.
    pub name: String,
    /// What starts the programs of runs.
    pub programs: Box<dyn PagePrograms>,
}

/// A page that listens on its port.
pub struct Server {
    listener: TcpListener,
    name: String,
    pages: Arc<Pages>,
}

impl Server {
    /// Begins to listen. Requests about runs need the token of this user.
    ///
    /// # Errors
    /// When the port is taken or not permitted, or a new token cannot be made.
    pub async fn listen(settings: Settings) -> Result<Server> {
        let Settings { folders, host, port, name, programs } = settings;
        let address = SocketAddr::new(host, port);
        let listener = TcpListener::bind(address).await;
        let listener = listener.with_context(|| format!("listening on {address}"))?;
        let guard = Guard { host, token: token::of_user()? };
        let pages = Pages::new(Runs::in_folders(folders, programs), guard);
        Ok(Server { listener, name, pages: Arc::new(pages) })
    }

    /// Returns the page's URL, with the token.
    ///
    /// # Errors
    /// When the system does not report the local address.
    pub fn address(&self) -> Result<String> {
        let Server { listener, name, pages } = self;
        Ok(url(listener.local_addr()?, name, &pages.guard.token))
    }

    /// Serves requests until `end`, or until the future is dropped. Browsers that listen at the end learn of the last
    /// changes, and may ask about them.
    ///
    /// # Errors
    /// When the listener or the thread that reads the runs fails.
    pub async fn serve(self, end: impl Future<Output = ()>) -> Result<()> {
        let Server { listener, pages, .. } = self;
        let watching = watch_runs(Arc::clone(&pages));
        let ending = end_with(Arc::clone(&pages), end);
        let serving = axum::serve(listener, router(pages));
        tokio::select! {
            ended = serving => Ok(ended?),
            ended = watching => ended,
            ended = ending => ended,
        }
    }
}

/// Returns the URL of a page. One that listens on all addresses has the machine's name, which others can open.
fn url(address: SocketAddr, name: &str, token: &str) -> String {
    let place = match address.ip() {
        ip if ip.is_unspecified() => format!("{name}:{}", address.port()),
        _ => address.to_string(),
    };
    format!("http://{place}/?token={token}")
}

fn router(pages: Arc<Pages>) -> Router {
    Router::new()
        .nest("/api", api::routes())
        .route("/", get(|| async { asset(Path(String::new())).await }))
        .route("/{name}", get(asset))
        .layer(from_fn_with_state(Arc::clone(&pages), guarded))
        .layer(map_response(with_headers))
        .with_state(pages)
}

/// Lists the runs at regular intervals while a browser listens to events, and sends the list when it has changed.
async fn watch_runs(pages: Arc<Pages>) -> Result<()> {
    loop {
        tokio::time::sleep(LOOK_EVERY).await;
        if pages.newest.receiver_count() > 0 {
            look(&pages).await?;
        }
    }
}

/// Waits for `end`. If a browser listens then, it gets the last list, and time to ask.
async fn end_with(pages: Arc<Pages>, end: impl Future<Output = ()>) -> Result<()> {
    end.await;
    if pages.newest.receiver_count() > 0 {
        look(&pages).await?;
        tokio::time::sleep(LAST_QUESTIONS).await;
    }
    Ok(())
}

/// Lists the runs, and sends the list if it has changed.
async fn look(pages: &Arc<Pages>) -> Result<()> {
    let list = Arc::new(pages.read(Runs::list).await?);
    pages.newest.send_if_modified(|known| {
        let is_new = **known != *list;
        *known = list;
        is_new
    });
    Ok(())
}

async fn asset(Path(name): Path<String>) -> Response {
    let Some(asset) = assets::find(&name) else {
        return Refused::unknown("there is no such page").into_response();
    };
    let kind = HeaderValue::from_static(asset.kind);
    ([(header::CONTENT_TYPE, kind)], asset.content).into_response()
}

async fn guarded(State(pages): State<Arc<Pages>>, request: Request, next: Next) -> Response {
    match pages.guard.admit(request.uri(), request.headers()) {
        Ok(()) => next.run(request).await,
        Err(line) => Refused(StatusCode::FORBIDDEN, line).into_response(),
    }
}

async fn with_headers(mut response: Response) -> Response {
    let headers = response.headers_mut();
    headers.insert(header::CONTENT_SECURITY_POLICY, HeaderValue::from_static(POLICY));
    headers.insert(header::X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
    headers.insert(header::REFERRER_POLICY, HeaderValue::from_static("no-referrer"));
    headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-store"));
    response
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_url_is_one_that_a_browser_opens() {
        for (address, place) in [
            ("127.0.0.1:7878", "127.0.0.1:7878"),
            ("[::1]:7878", "[::1]:7878"),
            ("0.0.0.0:7878", "here:7878"),
            ("[::]:7878", "here:7878"),
        ] {
            let found = url(address.parse().unwrap(), "here", "abc");
            assert_eq!(found, format!("http://{place}/?token=abc"));
        }
    }
}
