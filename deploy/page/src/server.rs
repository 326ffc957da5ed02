//! The address, the routes, the answers.

use std::convert::Infallible;
use std::fs::File;
use std::io::Read;
use std::net::{IpAddr, SocketAddr};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, Result};
use axum::extract::{Path, Query, Request, State};
use axum::http::{HeaderValue, StatusCode, header};
use axum::middleware::{Next, from_fn_with_state, map_response};
use axum::response::sse::{Event, KeepAlive, Sse};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use axum::{Json, Router};
use serde::{Deserialize, Serialize};
use serde_json::json;
use tokio::net::TcpListener;
use tokio::sync::{Semaphore, watch};
use tokio_stream::StreamExt;
use tokio_stream::wrappers::WatchStream;

use crate::assets;
use crate::guard::Guard;
use crate::listed::List;
use crate::runs::Runs;

/// How often the runs are looked at while somebody watches.
const LOOK_EVERY: Duration = Duration::from_secs(1);

/// Questions that read files at the same time; the others wait.
const READERS: usize = 2;

/// Browsers that are told of changes at the same time.
const WATCHERS: usize = 64;

/// What a page loads and from where: itself, nothing else.
const POLICY: &str = "default-src 'self'; img-src 'self' data: blob:; frame-ancestors 'none'; base-uri 'none'; \
                      form-action 'none'";

/// Where a page is and what it shows.
#[derive(Clone, Debug)]
pub struct Settings {
    /// Folders of runs, or of folders of runs.
    pub folders: Vec<PathBuf>,
    /// The address it listens on.
    pub host: IpAddr,
    /// The port; 0 takes a free one.
    pub port: u16,
}

/// A page that listens.
pub struct Server {
    listener: TcpListener,
    pages: Arc<Pages>,
}

struct Pages {
    runs: Runs,
    guard: Guard,
    readers: Semaphore,
    watchers: Arc<Semaphore>,
    newest: watch::Sender<Arc<List>>,
}

impl Server {
    /// Begins to listen. Outside this machine it answers those alone who have the token.
    ///
    /// # Errors
    /// When the port is taken or may not be had.
    pub async fn listen(settings: Settings) -> Result<Server> {
        let Settings { folders, host, port } = settings;
        let address = SocketAddr::new(host, port);
        let listener = TcpListener::bind(address).await;
        let listener = listener.with_context(|| format!("listening on {address}"))?;
        let token = (!host.is_loopback()).then(token).transpose()?;
        let pages = Pages {
            runs: Runs::in_folders(folders),
            guard: Guard { token },
            readers: Semaphore::new(READERS),
            watchers: Arc::new(Semaphore::new(WATCHERS)),
            newest: watch::Sender::new(Arc::default()),
        };
        Ok(Server { listener, pages: Arc::new(pages) })
    }

    /// Where a browser finds it.
    ///
    /// # Errors
    /// When the system does not say.
    pub fn address(&self) -> Result<String> {
        let address = self.listener.local_addr()?;
        Ok(match &self.pages.guard.token {
            Some(token) => format!("http://{address}/?token={token}"),
            None => format!("http://{address}"),
        })
    }

    /// Answers until it is dropped.
    ///
    /// # Errors
    /// When the system takes the listener away.
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
        .route("/api/runs", get(list))
        .route("/api/runs/{id}", get(details))
        .route("/api/runs/{id}/updates", get(updates))
        .route("/api/events", get(events))
        .route("/", get(|| async { asset(Path(String::new())).await }))
        .route("/{name}", get(asset))
        .layer(from_fn_with_state(Arc::clone(&pages), guarded))
        .layer(map_response(with_headers))
        .with_state(pages)
}

/// Looks at the runs while somebody watches, and tells of what has changed.
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

impl Pages {
    /// Reads files without holding up the other answers.
    async fn read<T: Send + 'static>(
        self: &Arc<Self>,
        read: impl FnOnce(&Runs) -> T + Send + 'static,
    ) -> Result<T> {
        let _turn = self.readers.acquire().await?;
        let pages = Arc::clone(self);
        Ok(tokio::task::spawn_blocking(move || read(&pages.runs)).await?)
    }
}

/// What a question without an answer gets: a line.
struct Refused(StatusCode, String);

impl From<anyhow::Error> for Refused {
    fn from(error: anyhow::Error) -> Self {
        Refused(StatusCode::INTERNAL_SERVER_ERROR, format!("{error:#}"))
    }
}

impl IntoResponse for Refused {
    fn into_response(self) -> Response {
        (self.0, Json(json!({ "error": self.1 }))).into_response()
    }
}

fn unknown(id: &str) -> Refused {
    Refused(StatusCode::NOT_FOUND, format!("no run is called {id}"))
}

async fn list(State(pages): State<Arc<Pages>>) -> Result<Json<List>, Refused> {
    Ok(Json(pages.read(Runs::list).await?))
}

async fn details(
    State(pages): State<Arc<Pages>>,
    Path(id): Path<String>,
) -> Result<impl IntoResponse, Refused> {
    let name = id.clone();
    let found = pages.read(move |runs| runs.details(&name)).await?;
    Ok(Json(found.ok_or_else(|| unknown(&id))??))
}

/// From which row on updates are asked for.
#[derive(Deserialize)]
struct FirstRow {
    #[serde(default)]
    from: usize,
}

async fn updates(
    State(pages): State<Arc<Pages>>,
    Path(id): Path<String>,
    Query(FirstRow { from }): Query<FirstRow>,
) -> Result<Response, Refused> {
    let name = id.clone();
    let found = pages.read(move |runs| runs.curves(&name)).await?;
    Ok(in_json(&found.ok_or_else(|| unknown(&id))?.from(from)))
}

fn in_json(answer: &impl Serialize) -> Response {
    Json(answer).into_response()
}

/// The list of runs now, and again whenever it has changed. A browser that is slow misses lists, never the newest.
async fn events(State(pages): State<Arc<Pages>>) -> Result<impl IntoResponse, Refused> {
    let place = Arc::clone(&pages.watchers).try_acquire_owned().map_err(|_taken| {
        let line = format!("{WATCHERS} browsers are told of changes already");
        Refused(StatusCode::SERVICE_UNAVAILABLE, line)
    })?;
    let changes = WatchStream::from_changes(pages.newest.subscribe());
    let now = Arc::new(pages.read(Runs::list).await?);
    let lists = tokio_stream::once(now).chain(changes).map(move |list| {
        let _held = &place;
        let event = Event::default().event("runs").json_data(&*list);
        Ok::<_, Infallible>(event.unwrap_or_default())
    });
    Ok(Sse::new(lists).keep_alive(KeepAlive::default()))
}

async fn asset(Path(name): Path<String>) -> Response {
    let Some(asset) = assets::find(&name) else {
        return Refused(StatusCode::NOT_FOUND, "there is no such page".to_owned()).into_response();
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
