//! The server: its address, the admission of requests, the headers of responses, and events on changes of runs.

use std::fs::File;
use std::io::Read;
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
use crate::{api, assets};

/// Interval at which the runs are checked for changes while a browser listens to events.
const LOOK_EVERY: Duration = Duration::from_secs(1);

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
    /// What starts the programs of runs.
    pub programs: Box<dyn PagePrograms>,
}

/// A page that listens on its port.
pub struct Server {
    listener: TcpListener,
    pages: Arc<Pages>,
}

impl Server {
    /// Begins to listen. If `host` is not a loopback address, requests about runs need a token.
    ///
    /// # Errors
    /// When the port is taken or not permitted.
    pub async fn listen(settings: Settings) -> Result<Server> {
        let Settings { folders, host, port, programs } = settings;
        let address = SocketAddr::new(host, port);
        let listener = TcpListener::bind(address).await;
        let listener = listener.with_context(|| format!("listening on {address}"))?;
        let token = (!host.is_loopback()).then(token).transpose()?;
        let pages = Pages::new(Runs::in_folders(folders, programs), Guard { host, token });
        Ok(Server { listener, pages: Arc::new(pages) })
    }

    /// Returns the page's URL, with the token if there is one.
    ///
    /// # Errors
    /// When the system does not report the local address.
    pub fn address(&self) -> Result<String> {
        let address = self.listener.local_addr()?;
        Ok(match &self.pages.guard.token {
            Some(token) => format!("http://{address}/?token={token}"),
            None => format!("http://{address}"),
        })
    }

    /// Serves requests until the future is dropped.
    ///
    /// # Errors
    /// When the listener or the thread that reads the runs fails.
    pub async fn serve(self) -> Result<()> {
        let Server { listener, pages } = self;
        let watching = watch_runs(Arc::clone(&pages));
        let serving = axum::serve(listener, router(pages));
        tokio::select! {
            ended = serving => Ok(ended?),
            ended = watching => ended,
        }
    }
}

fn token() -> Result<String> {
    let mut bytes = [0; 16];
    File::open("/dev/urandom")?.read_exact(&mut bytes)?;
    Ok(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
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
        if pages.newest.receiver_count() == 0 {
            continue;
        }
        let list = Arc::new(pages.read(Runs::list).await?);
        pages.newest.send_if_modified(|known| {
            let is_new = **known != *list;
            *known = list;
            is_new
        });
    }
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
