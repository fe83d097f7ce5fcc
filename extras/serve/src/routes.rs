//! The requests that the server answers.

use std::sync::Arc;

use axum::Router;
use axum::body::Bytes;
use axum::extract::{DefaultBodyLimit, Path, RawQuery, Request, State};
use axum::http::{HeaderName, HeaderValue, StatusCode, header};
use axum::middleware::{Next, from_fn_with_state};
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use crate::addition::Addition;
use crate::assets;
use crate::difference::Difference;
use crate::door::{HEADERS, Refused as Denied};
use crate::editor::{Edit, MAX_VALUE, Refused};
use crate::events::events;
use crate::ground::{Ray, ground};
use crate::live::{Live, Start, Upright};
use crate::packed::{self, MOST_SPLATS};
use crate::place::place;
use crate::presets::Choice;
use crate::surface::Surface;
use crate::thing::Thing;
use crate::values::{floats, halves, png};
use crate::view::view;

/// Maximum length of the body of a request in bytes.
const MAX_BODY: usize = 2 * MAX_VALUE + 4096;

type Shared = State<Arc<Live>>;

/// A response in JSON.
struct Json<T>(T);

impl<T: Serialize> IntoResponse for Json<T> {
    fn into_response(self) -> Response {
        match serde_json::to_vec(&self.0) {
            Ok(bytes) => ([(header::CONTENT_TYPE, "application/json")], bytes).into_response(),
            Err(_) => StatusCode::INTERNAL_SERVER_ERROR.into_response(),
        }
    }
}

/// The router of a server.
pub fn router(live: Arc<Live>) -> Router {
    Router::new()
        .route("/session", post(session))
        .route("/events", get(|State(live): Shared| async move { events(&live) }))
        .route("/graph", get(graph))
        .route("/value/{digest}", get(describe))
        .route("/value/{digest}/{picture}", get(picture))
        .route("/difference/{a}/{i}/{b}/{j}", get(difference))
        .route("/difference/{a}/{i}/{b}/{j}/flip.f32", get(flip))
        .route("/references", get(references))
        .route("/graphs", get(graphs))
        .route("/objects", get(objects))
        .route("/trade", get(trade))
        .route("/preset", post(preset))
        .route("/place", get(place_view))
        .route("/splats/{digest}", get(splats))
        .route("/mesh/{digest}", get(mesh))
        .route("/object/{digest}", get(object))
        .route("/ground", post(ground_at))
        .route("/set", post(set))
        .route("/try", post(try_value))
        .route("/plan", post(plan))
        .route("/start", post(start))
        .route("/up", post(upright))
        .route("/add", post(add))
        .route("/undo", post(|state: Shared, body: Bytes| step(state, body, true)))
        .route("/redo", post(|state: Shared, body: Bytes| step(state, body, false)))
        .fallback(file)
        .layer(DefaultBodyLimit::max(MAX_BODY))
        .layer(from_fn_with_state(live.clone(), guard))
        .with_state(live)
}

/// Checks every request before it is routed, and adds the headers of every response.
async fn guard(State(live): Shared, request: Request, next: Next) -> Response {
    let path = request.uri().path();
    let open = assets::file(path).is_some() || path == "/session";
    let mut response = match live.door.check(request.method(), request.uri(), request.headers(), open) {
        Ok(()) => next.run(request).await,
        Err(Denied { status, why }) => (status, Json(json!({"code": "denied", "why": why}))).into_response(),
    };
    let headers = response.headers_mut();
    for (name, value) in HEADERS {
        headers.insert(HeaderName::from_static(name), HeaderValue::from_static(value));
    }
    headers.entry(header::CACHE_CONTROL).or_insert(HeaderValue::from_static("no-store"));
    response
}

/// A file of the page; 404 for any other path.
async fn file(request: Request) -> Response {
    match assets::file(request.uri().path()) {
        Some((kind, content)) => ([(header::CONTENT_TYPE, kind)], content).into_response(),
        None => missing("there is no page at this address"),
    }
}

fn missing(why: &str) -> Response {
    (StatusCode::NOT_FOUND, Json(json!({"code": "missing", "why": why}))).into_response()
}

fn malformed(why: &dyn std::fmt::Display) -> Response {
    (StatusCode::BAD_REQUEST, Json(json!({"code": "malformed", "why": why.to_string()}))).into_response()
}

/// Parses a body and answers it on a thread that may block.
async fn answer<T: DeserializeOwned + Send + 'static>(
    live: Arc<Live>,
    body: Bytes,
    act: impl FnOnce(&Live, T) -> Result<Value, Refused> + Send + 'static,
) -> Response {
    let parsed = match serde_json::from_slice(&body) {
        Ok(parsed) => parsed,
        Err(error) => return malformed(&error),
    };
    match tokio::task::spawn_blocking(move || act(&live, parsed)).await {
        Ok(Ok(value)) => Json(value).into_response(),
        Ok(Err(refused)) => {
            let status = match &refused {
                Refused::Stale { .. } | Refused::Nothing => StatusCode::CONFLICT,
                Refused::Gone { .. } => StatusCode::GONE,
                Refused::Confined => StatusCode::FORBIDDEN,
                Refused::Fixed { .. } | Refused::Invalid { .. } => StatusCode::UNPROCESSABLE_ENTITY,
                Refused::Unwritten { .. } => StatusCode::INSUFFICIENT_STORAGE,
            };
            (status, Json(refused)).into_response()
        }
        Err(_) => failed("the request failed because of an internal error"),
    }
}

fn failed(why: &str) -> Response {
    (StatusCode::INTERNAL_SERVER_ERROR, Json(json!({"code": "failed", "why": why}))).into_response()
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Token {
    token: String,
}

/// Exchanges the token for the cookie.
async fn session(State(live): Shared, body: Bytes) -> Response {
    let admitted = serde_json::from_slice(&body).ok().and_then(|Token { token }| live.door.admit(&token));
    match admitted.and_then(|cookie| HeaderValue::from_str(&cookie).ok()) {
        Some(cookie) => ([(header::SET_COOKIE, cookie)], Json(json!({}))).into_response(),
        None => {
            let why = "the token is wrong; open the address that `lightharmony watch --serve` printed";
            (StatusCode::FORBIDDEN, Json(json!({"code": "denied", "why": why}))).into_response()
        }
    }
}

async fn graph(State(live): Shared) -> Response {
    let described = move || {
        let mut view = live.with_state(view);
        view["starts"] = live.starter.is_some().into();
        view
    };
    match tokio::task::spawn_blocking(described).await {
        Ok(view) => Json(view).into_response(),
        Err(_) => failed("the graph cannot be described"),
    }
}

async fn set(State(live): Shared, body: Bytes) -> Response {
    answer(live, body, |live, edit: Edit| live.set(&edit)).await
}

async fn plan(State(live): Shared, body: Bytes) -> Response {
    answer(live, body, |live, edit: Edit| live.plan(&edit)).await
}

/// Tries a value; `null` ends the trial.
async fn try_value(State(live): Shared, body: Bytes) -> Response {
    answer(live, body, |live, edit: Option<Edit>| match edit {
        Some(edit) => live.try_value(&edit),
        None => Ok(live.end_try()),
    })
    .await
}

async fn start(State(live): Shared, body: Bytes) -> Response {
    answer(live, body, |live, start: Start| live.start(&start)).await
}

async fn upright(State(live): Shared, body: Bytes) -> Response {
    answer(live, body, |live, upright: Upright| live.upright(&upright)).await
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Seen {
    digest: String,
}

async fn step(State(live): Shared, body: Bytes, undo: bool) -> Response {
    answer(live, body, move |live, Seen { digest }| live.step(&digest, undo)).await
}

/// Cache header of the responses that contain a value. A value never changes.
const IMMUTABLE: (HeaderName, &str) = (header::CACHE_CONTROL, "private, max-age=31536000, immutable");

const GONE: &str = "this value is no longer in the cache, or belongs to another graph";

async fn describe(State(live): Shared, Path(digest): Path<String>) -> Response {
    let described = move || live.value(&digest).map(|shown| json!(shown.description()));
    match tokio::task::spawn_blocking(described).await {
        Ok(Some(json)) => ([IMMUTABLE], Json(json)).into_response(),
        Ok(None) => missing(GONE),
        Err(_) => failed("the value cannot be read"),
    }
}

/// The digests of two values and the indices of pictures in them.
type Pair = (String, usize, String, usize);

/// Computes the difference of two pictures, and answers with a part of it.
async fn compared(
    live: Arc<Live>,
    (a, i, b, j): Pair,
    part: impl FnOnce(Result<&Difference, &String>) -> Option<Response> + Send + 'static,
) -> Response {
    let found = tokio::task::spawn_blocking(move || live.difference(&(a, i), &(b, j))).await;
    match found {
        Ok(Some(found)) => part(found.as_deref()).unwrap_or_else(|| missing("these pictures have no FLIP")),
        Ok(None) => missing(GONE),
        Err(_) => failed("the pictures cannot be compared"),
    }
}

async fn difference(State(live): Shared, Path(pair): Path<Pair>) -> Response {
    let part = |found: Result<&Difference, &String>| {
        // The page shows pictures that cannot be compared as well, so this is an answer.
        let found = match found {
            Ok(found) => found,
            Err(why) => {
                return Some(
                    Json(json!({"report": {"tables": []}, "notes": [why], "flip": null})).into_response(),
                );
            }
        };
        let size = found.flip.as_ref().map(|flip| [flip.size().0, flip.size().1]);
        Some(Json(json!({"report": found.report, "notes": found.notes, "flip": size})).into_response())
    };
    compared(live, pair, part).await
}

/// FLIP of each pixel as little-endian f32, row by row.
async fn flip(State(live): Shared, Path(pair): Path<Pair>) -> Response {
    let part = |found: Result<&Difference, &String>| {
        let kind = (header::CONTENT_TYPE, "application/octet-stream");
        Some(([kind, (IMMUTABLE.0, IMMUTABLE.1)], floats(found.ok()?.flip.as_ref()?)).into_response())
    };
    compared(live, pair, part).await
}

async fn references(State(live): Shared) -> Response {
    match tokio::task::spawn_blocking(move || live.references.list(live.folder())).await {
        Ok(list) => Json(list).into_response(),
        Err(_) => failed("the folder of the graph cannot be read"),
    }
}

async fn graphs(State(live): Shared) -> Response {
    match tokio::task::spawn_blocking(move || live.graphs.list(&live.engine, live.path())).await {
        Ok(list) => Json(list).into_response(),
        Err(_) => failed("the folder of the graph cannot be read"),
    }
}

async fn objects(State(live): Shared) -> Response {
    match tokio::task::spawn_blocking(move || live.objects()).await {
        Ok(list) => Json(list).into_response(),
        Err(_) => failed("the folder of the graph cannot be read"),
    }
}

async fn add(State(live): Shared, body: Bytes) -> Response {
    answer(live, body, |live, addition: Addition| live.add(&addition)).await
}

async fn trade(State(live): Shared) -> Response {
    answer(live, Bytes::from_static(b"null"), |live, (): ()| live.trade()).await
}

async fn preset(State(live): Shared, body: Bytes) -> Response {
    answer(live, body, |live, choice: Choice| live.preset(&choice)).await
}

async fn place_view(State(live): Shared) -> Response {
    match tokio::task::spawn_blocking(move || place(&live)).await {
        Ok(place) => Json(place).into_response(),
        Err(_) => failed("the place cannot be described"),
    }
}

/// Answers with a value of the place as bytes.
async fn thing(live: Arc<Live>, digest: String, pack: fn(&Thing) -> Option<Vec<u8>>) -> Response {
    let packed = move || live.thing(&digest).and_then(|thing| pack(&thing));
    match tokio::task::spawn_blocking(packed).await {
        Ok(Some(bytes)) => {
            let kind = (header::CONTENT_TYPE, "application/octet-stream");
            ([kind, (IMMUTABLE.0, IMMUTABLE.1)], bytes).into_response()
        }
        Ok(None) => missing(GONE),
        Err(_) => failed("the value cannot be packed"),
    }
}

async fn splats(State(live): Shared, Path(digest): Path<String>) -> Response {
    let pack = |thing: &Thing| match thing {
        Thing::Splats(splats) => Some(packed::splats(splats, MOST_SPLATS)),
        _ => None,
    };
    thing(live, digest, pack).await
}

async fn mesh(State(live): Shared, Path(digest): Path<String>) -> Response {
    let pack = |thing: &Thing| match thing {
        Thing::Mesh(mesh) => Some(Surface::of_mesh(mesh).pack()),
        _ => None,
    };
    thing(live, digest, pack).await
}

async fn object(State(live): Shared, Path(digest): Path<String>) -> Response {
    thing(live, digest, |thing| thing.object().map(|object| Surface::of_object(object).pack())).await
}

/// The surface along a ray; `null` with the reason if the ray meets nothing.
async fn ground_at(State(live): Shared, body: Bytes) -> Response {
    answer(live, body, |live, ray: Ray| {
        Ok(ground(live, &ray).unwrap_or_else(|why| json!({"position": null, "why": why})))
    })
    .await
}

/// How a picture is displayed.
struct Display {
    /// Exposure of linear light in stops.
    exposure: f32,
    /// Longest side in pixels.
    size: Option<usize>,
}

impl Display {
    /// Parses `exposure=1.5&size=160`; `None` for anything else.
    fn read(query: &str) -> Option<Self> {
        let mut display = Self { exposure: 0.0, size: None };
        for (name, value) in query
            .split('&')
            .filter(|pair| !pair.is_empty())
            .map(|pair| pair.split_once('='))
            .collect::<Option<Vec<_>>>()?
        {
            match name {
                "exposure" => {
                    display.exposure = value.parse().ok().filter(|stops: &f32| stops.abs() <= 64.0)?;
                }
                "size" => display.size = Some(value.parse().ok().filter(|size| *size > 0)?),
                _ => return None,
            }
        }
        Some(display)
    }
}

/// A picture of a value: `0.png`, `0.f32` or `0.f16`.
async fn picture(
    State(live): Shared,
    Path((digest, name)): Path<(String, String)>,
    RawQuery(query): RawQuery,
) -> Response {
    let Some(Display { exposure, size }) = Display::read(&query.unwrap_or_default()) else {
        return malformed(
            &"a picture takes the parameters `exposure`, from -64 to 64 stops, and `size`, at least 1 pixel",
        );
    };
    let form = name
        .split_once('.')
        .and_then(|(number, form)| Some((number.parse::<usize>().ok()?, form.to_owned())));
    let Some((number, form)) = form.filter(|(_, form)| ["png", "f32", "f16"].contains(&form.as_str())) else {
        return missing("a picture must have a name such as `0.png`, `0.f32` or `0.f16`");
    };
    let tag = format!("\"{digest}-{name}-{exposure}-{}\"", size.unwrap_or_default());
    let bytes = move || {
        let shown = live.value(&digest)?;
        let picture = &shown.pictures.get(number)?.picture;
        Some(match form.as_str() {
            "png" => png(picture, exposure, size).map(|bytes| ("image/png", bytes)),
            "f32" => Ok(("application/octet-stream", floats(picture))),
            _ => Ok(("application/octet-stream", halves(picture))),
        })
    };
    match tokio::task::spawn_blocking(bytes).await {
        Ok(Some(Ok((kind, bytes)))) => (
            [
                (header::CONTENT_TYPE, kind.to_owned()),
                (header::ETAG, tag),
                (IMMUTABLE.0, IMMUTABLE.1.to_owned()),
            ],
            bytes,
        )
            .into_response(),
        Ok(None) => missing(GONE),
        Ok(Some(Err(_))) | Err(_) => failed("the picture cannot be encoded"),
    }
}
