//! The stream of messages to one page, as server-sent events.

use std::convert::Infallible;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use axum::body::{Body, Bytes};
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use futures_util::stream;
use tokio::sync::broadcast::Receiver;
use tokio::sync::broadcast::error::RecvError;

use crate::live::{Live, Message};

/// Maximum number of connected pages.
const MOST_CLIENTS: usize = 16;
/// Interval between the comments that keep a connection open and detect that it was closed.
const ALIVE: Duration = Duration::from_secs(10);

/// A connected page. When the last page disconnects, trial values are dropped.
struct Client(Arc<Live>);

impl Client {
    fn enter(live: &Arc<Live>) -> Option<Self> {
        let entered = live.clients.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |count| {
            (count < MOST_CLIENTS).then_some(count + 1)
        });
        entered.ok().map(|_| Self(live.clone()))
    }
}

impl Drop for Client {
    fn drop(&mut self) {
        if self.0.clients.fetch_sub(1, Ordering::Relaxed) == 1 {
            self.0.end_try();
        }
    }
}

/// The next item of a stream.
struct Following {
    client: Client,
    receiver: Receiver<Arc<Message>>,
    /// Number of the last message that the client has.
    number: u64,
}

/// The whole state, followed by every event. A page that reads too slowly gets the whole state again instead of the
/// events that it has missed, so the queue of a page stays short.
pub fn events(live: &Arc<Live>) -> Response {
    let Some(client) = Client::enter(live) else {
        let why = format!("{MOST_CLIENTS} pages are open already; close one of them");
        return (StatusCode::SERVICE_UNAVAILABLE, why).into_response();
    };
    let (first, receiver) = live.subscribe();
    let following = Following { client, receiver, number: first.number };
    let start = (Some(first), following);
    let stream = stream::unfold(start, |(first, mut following)| async move {
        let bytes = match first {
            Some(message) => text(&message),
            None => following.next().await?,
        };
        Some((Ok::<_, Infallible>(bytes), (None, following)))
    });
    let headers = [(header::CONTENT_TYPE, "text/event-stream"), (header::CACHE_CONTROL, "no-store")];
    (headers, Body::from_stream(stream)).into_response()
}

impl Following {
    async fn next(&mut self) -> Option<Bytes> {
        loop {
            match tokio::time::timeout(ALIVE, self.receiver.recv()).await {
                Err(_) => return Some(Bytes::from_static(b": alive\n\n")),
                // The state contains it.
                Ok(Ok(message)) if message.number <= self.number => {}
                Ok(Ok(message)) => {
                    self.number = message.number;
                    return Some(text(&message));
                }
                Ok(Err(RecvError::Lagged(_))) => {
                    let state = self.client.0.snapshot();
                    self.number = state.number;
                    return Some(text(&state));
                }
                Ok(Err(RecvError::Closed)) => return None,
            }
        }
    }
}

fn text(message: &Message) -> Bytes {
    // JSON has no line breaks outside strings, and those in strings are escaped.
    format!("id: {}\ndata: {}\n\n", message.number, message.data).into()
}
