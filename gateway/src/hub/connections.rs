//! Connections to the hub. Their number is limited before the handshake: each is an open file, and strangers can make
//! any number of them.

use std::io;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Duration;

use protocol::dropped::Dropped;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, mpsc};
use tokio_stream::wrappers::ReceiverStream;
use tonic::transport::server::{Connected, TcpConnectInfo};

/// Pause after a connection could not be accepted, for example because there is no room for an open file.
const PAUSE: Duration = Duration::from_millis(100);

/// A connection, which has a place among those of the hub until it is dropped.
pub(super) struct Connection {
    stream: TcpStream,
    _place: OwnedSemaphorePermit,
}

/// Accepts connections, at most `most` at once, inside a Tokio runtime. Further ones wait in the system's queue. The
/// listener is closed when the returned stream is dropped.
pub(super) fn accepted(
    listener: TcpListener,
    most: usize,
) -> ReceiverStream<io::Result<Connection>> {
    let (taken, connections) = mpsc::channel(1);
    tokio::spawn(accept(listener, Arc::new(Semaphore::new(most)), taken));
    ReceiverStream::new(connections)
}

async fn accept(
    listener: TcpListener,
    places: Arc<Semaphore>,
    taken: mpsc::Sender<io::Result<Connection>>,
) {
    let mut failed = Dropped::new("connections");
    loop {
        let next = tokio::select! {
            next = next(&listener, &places) => next,
            () = taken.closed() => return,
        };
        match next {
            Ok(connection) => {
                taken.send(Ok(connection)).await.ok();
            }
            Err(why) => {
                failed.note(why);
                tokio::time::sleep(PAUSE).await;
            }
        }
    }
}

async fn next(listener: &TcpListener, places: &Arc<Semaphore>) -> io::Result<Connection> {
    let place = Arc::clone(places).acquire_owned().await.map_err(io::Error::other)?;
    let (stream, _) = listener.accept().await?;
    // Small replies are sent at once.
    stream.set_nodelay(true).ok();
    Ok(Connection { stream, _place: place })
}

impl Connected for Connection {
    type ConnectInfo = TcpConnectInfo;

    fn connect_info(&self) -> TcpConnectInfo {
        self.stream.connect_info()
    }
}

impl AsyncRead for Connection {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_read(context, buffer)
    }
}

impl AsyncWrite for Connection {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.stream).poll_write(context, bytes)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        slices: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.stream).poll_write_vectored(context, slices)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(context)
    }
}

#[cfg(test)]
mod tests {
    use tokio::time::timeout;
    use tokio_stream::StreamExt;

    use super::*;

    #[test]
    fn a_connection_beyond_the_limit_waits_until_another_has_ended() {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        runtime.block_on(async {
            let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
            let address = listener.local_addr().unwrap();
            let mut connections = accepted(listener, 2);
            let _strangers = [TcpStream::connect(address).await, TcpStream::connect(address).await];
            let _third = TcpStream::connect(address).await.unwrap();
            let first = connections.next().await.unwrap().unwrap();
            let _second = connections.next().await.unwrap().unwrap();
            let waiting = timeout(Duration::from_millis(100), connections.next()).await;
            assert!(waiting.is_err(), "expected a third connection to wait");
            drop(first);
            connections.next().await.unwrap().unwrap();
            drop(connections);
            while TcpStream::connect(address).await.is_ok() {
                tokio::task::yield_now().await;
            }
        });
    }
}
