//! State that all request handlers share: the runs, the guard, and limits on concurrent work.

use std::process::ExitCode;
use std::sync::Arc;

use anyhow::Result;
use axum::Json;
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use serde_json::json;
use terminal::refusal::{WRONG_USAGE, exit_code};
use tokio::sync::{Semaphore, watch};

use crate::guard::Guard;
use crate::listed::List;
use crate::runs::Runs;

/// Maximum number of requests that read files at the same time; others wait.
const READERS: usize = 4;

/// Maximum number of requests for single episodes at the same time. Most start a program, possibly during training.
const PLAYERS: usize = 2;

/// Maximum number of browsers that receive events at the same time.
pub(crate) const WATCHERS: usize = 64;

/// State that all request handlers share.
pub(crate) struct Pages {
    runs: Runs,
    pub(crate) guard: Guard,
    readers: Arc<Semaphore>,
    players: Arc<Semaphore>,
    pub(crate) watchers: Arc<Semaphore>,
    pub(crate) newest: watch::Sender<Arc<List>>,
}

impl Pages {
    /// Returns the state of a new server.
    pub(crate) fn new(runs: Runs, guard: Guard) -> Pages {
        Pages {
            runs,
            guard,
            readers: Arc::new(Semaphore::new(READERS)),
            players: Arc::new(Semaphore::new(PLAYERS)),
            watchers: Arc::new(Semaphore::new(WATCHERS)),
            newest: watch::Sender::new(Arc::default()),
        }
    }

    /// Runs `read` on a blocking thread, so that other requests are not delayed.
    pub(crate) async fn read<T: Send + 'static>(
        self: &Arc<Self>,
        read: impl FnOnce(&Runs) -> T + Send + 'static,
    ) -> Result<T> {
        self.take_turn(&self.readers, read).await
    }

    /// Runs `play`, the work for a single episode, under a limit of its own, so that requests that read files are
    /// not delayed.
    pub(crate) async fn play<T: Send + 'static>(
        self: &Arc<Self>,
        play: impl FnOnce(&Runs) -> T + Send + 'static,
    ) -> Result<T> {
        self.take_turn(&self.players, play).await
    }

    /// Waits for a permit of `turns`, then does `work` on a blocking thread. The permit is held until the work is
    /// done, even if the client has disconnected.
    async fn take_turn<T: Send + 'static>(
        self: &Arc<Self>,
        turns: &Arc<Semaphore>,
        work: impl FnOnce(&Runs) -> T + Send + 'static,
    ) -> Result<T> {
        let turn = Arc::clone(turns).acquire_owned().await?;
        let pages = Arc::clone(self);
        let work = move || {
            let _turn = turn;
            work(&pages.runs)
        };
        Ok(tokio::task::spawn_blocking(work).await?)
    }
}

/// An error response: a status and one line.
pub(crate) struct Refused(pub(crate) StatusCode, pub(crate) String);

impl Refused {
    /// Returns the response for something that does not exist.
    pub(crate) fn unknown(line: impl Into<String>) -> Refused {
        Refused(StatusCode::NOT_FOUND, line.into())
    }

    /// Returns the response for a failure of what was asked with settings, which may be wrong.
    pub(crate) fn of_settings(error: anyhow::Error) -> Refused {
        let is_wrong = exit_code(&error) == ExitCode::from(WRONG_USAGE);
        let refused = Refused::from(error);
        if is_wrong { Refused(StatusCode::BAD_REQUEST, refused.1) } else { refused }
    }
}

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
