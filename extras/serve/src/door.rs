//! The checks that every request must pass before it is routed.
//!
//! The page of any web site, and any other local server, can send requests to this server through the user's
//! browser. Only requests from the live page pass the checks: only this page knows the token, which is part of the
//! printed address.

use axum::http::header::{CONTENT_TYPE, COOKIE, HOST, ORIGIN};
use axum::http::{HeaderMap, HeaderName, HeaderValue, Method, StatusCode, Uri};
use cache::Digest;

/// Name of the header that the page adds to every POST. A page of another origin cannot add this header without the
/// consent of the server, which is never given.
pub const CUSTOM: &str = "x-lightharmony";

/// The reason why a request is refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Refused {
    /// Status of the response.
    pub status: StatusCode,
    /// Text for the user.
    pub why: &'static str,
}

const fn forbidden(why: &'static str) -> Refused {
    Refused { status: StatusCode::FORBIDDEN, why }
}

const HOST_UNKNOWN: Refused = forbidden("this server answers only requests to its own local address");
const OTHER_ORIGIN: Refused = forbidden("requests from other sites are refused");
const NO_HEADER: Refused = forbidden("a request that makes a change needs the header `X-Lightharmony: 1`");
const NO_COOKIE: Refused = Refused {
    status: StatusCode::UNAUTHORIZED,
    why: "open the address that `lightharmony watch --serve` printed; it contains the token",
};
const NO_JSON: Refused = Refused {
    status: StatusCode::UNSUPPORTED_MEDIA_TYPE,
    why: "a request that makes a change must have the content type application/json",
};
const METHOD: Refused =
    Refused { status: StatusCode::METHOD_NOT_ALLOWED, why: "only the methods GET and POST are supported" };

/// The secret of a server, and the host names in requests that it answers.
pub struct Door {
    token: String,
    /// Value of the cookie. It is not the token itself, so the address with the token cannot be derived from the
    /// cookie.
    session: String,
    cookie: String,
    hosts: [String; 3],
}

impl Door {
    /// The checks of a server at `port` with the token `token`.
    pub fn new(token: String, port: u16) -> Self {
        let session = Digest::of(format!("session of {token}").as_bytes()).to_string();
        let hosts = ["127.0.0.1", "localhost", "[::1]"].map(|host| format!("{host}:{port}"));
        Self { token, session, cookie: format!("lightharmony-{port}"), hosts }
    }

    /// The address to open. The token is in the fragment, which browsers do not send.
    pub fn url(&self) -> String {
        format!("http://{}/#{}", self.hosts[0], self.token)
    }

    /// Checks a request. `open` is true for the files of the page itself, which contain nothing private.
    pub fn check(&self, method: &Method, uri: &Uri, headers: &HeaderMap, open: bool) -> Result<(), Refused> {
        let host = only(headers, &HOST).ok_or(HOST_UNKNOWN)?;
        let known = |host: &str| self.hosts.iter().any(|known| known == host);
        if !known(host) || uri.authority().is_some_and(|authority| !known(authority.as_str())) {
            return Err(HOST_UNKNOWN);
        }
        let post = match *method {
            Method::POST => true,
            Method::GET | Method::HEAD => false,
            _ => return Err(METHOD),
        };
        let own = format!("http://{host}");
        if headers.get_all(ORIGIN).iter().any(|origin| origin.as_bytes() != own.as_bytes()) {
            return Err(OTHER_ORIGIN);
        }
        // A link on another site may open the page, but nothing more. `same-site` includes other local servers.
        let sites = headers.get_all("sec-fetch-site").iter();
        let mut sites = sites.map(HeaderValue::as_bytes);
        if !sites.all(|site| site == b"same-origin" || !post && (open || site == b"none")) {
            return Err(OTHER_ORIGIN);
        }
        if post && only(headers, &HeaderName::from_static(CUSTOM)) != Some("1") {
            return Err(NO_HEADER);
        }
        if post && only(headers, &CONTENT_TYPE) != Some("application/json") {
            return Err(NO_JSON);
        }
        if open || self.has_cookie(headers) { Ok(()) } else { Err(NO_COOKIE) }
    }

    /// True if the request has the cookie of this server.
    pub fn has_cookie(&self, headers: &HeaderMap) -> bool {
        let cookies = headers.get_all(COOKIE).iter().filter_map(|line| line.to_str().ok());
        cookies
            .flat_map(|line| line.split(';'))
            .filter_map(|pair| pair.trim().split_once('='))
            .any(|(name, value)| name == self.cookie && equal(value, &self.session))
    }

    /// The `Set-Cookie` header for a client that knows the token; `None` for any other client.
    pub fn admit(&self, token: &str) -> Option<String> {
        equal(token, &self.token)
            .then(|| format!("{}={}; Path=/; HttpOnly; SameSite=Strict", self.cookie, self.session))
    }
}

/// Compares two texts by their digests, so that the time does not depend on the position of the first difference.
fn equal(a: &str, b: &str) -> bool {
    Digest::of(a.as_bytes()) == Digest::of(b.as_bytes())
}

/// The value of a header; `None` if the request does not have exactly one header with this name.
fn only<'h>(headers: &'h HeaderMap, name: &HeaderName) -> Option<&'h str> {
    let mut values = headers.get_all(name).iter();
    let value = values.next()?.to_str().ok()?;
    values.next().is_none().then_some(value)
}

/// Headers of every response.
pub const HEADERS: [(&str, &str); 7] = [
    (
        "content-security-policy",
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; connect-src 'self'; \
         worker-src 'self' blob:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    ),
    ("x-content-type-options", "nosniff"),
    ("cross-origin-resource-policy", "same-origin"),
    ("cross-origin-opener-policy", "same-origin"),
    ("referrer-policy", "no-referrer"),
    ("x-frame-options", "DENY"),
    ("permissions-policy", "camera=(), microphone=(), geolocation=()"),
];

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may panic")]
mod tests {
    use super::*;

    fn headers(pairs: &[(&'static str, &str)]) -> HeaderMap {
        let mut headers = HeaderMap::new();
        for (name, value) in pairs {
            headers.append(*name, HeaderValue::from_str(value).unwrap());
        }
        headers
    }

    fn checked(method: Method, uri: &str, pairs: &[(&'static str, &str)], open: bool) -> Option<Refused> {
        let door = Door::new("secret".to_owned(), 4000);
        door.check(&method, &uri.parse().unwrap(), &headers(pairs), open).err()
    }

    #[test]
    fn only_the_own_host_is_answered() {
        for host in ["127.0.0.1:4000", "localhost:4000", "[::1]:4000"] {
            assert_eq!(checked(Method::GET, "/", &[("host", host)], true), None, "{host}");
        }
        for host in [
            "127.0.0.1",
            "127.0.0.1:80",
            "localhost",
            "localhost.attacker.com:4000",
            "attacker.com:4000",
            "LOCALHOST:4000",
            "127.0.0.1:4000.attacker.com",
            "127.1:4000",
            "0.0.0.0:4000",
            "",
            "localhost:4000@attacker.com",
        ] {
            assert_eq!(checked(Method::GET, "/", &[("host", host)], true), Some(HOST_UNKNOWN), "{host}");
        }
        assert_eq!(checked(Method::GET, "/", &[], true), Some(HOST_UNKNOWN));
        let twice = [("host", "127.0.0.1:4000"), ("host", "127.0.0.1:4000")];
        assert_eq!(checked(Method::GET, "/", &twice, true), Some(HOST_UNKNOWN));
        let host = [("host", "127.0.0.1:4000")];
        assert_eq!(checked(Method::GET, "http://attacker.com/", &host, true), Some(HOST_UNKNOWN));
    }

    #[test]
    fn a_post_needs_origin_site_header_type_and_cookie() {
        let door = Door::new("secret".to_owned(), 4000);
        let cookie = door.admit("secret").unwrap().split(';').next().unwrap().to_owned();
        let good = [
            ("host", "127.0.0.1:4000"),
            ("origin", "http://127.0.0.1:4000"),
            ("sec-fetch-site", "same-origin"),
            ("x-lightharmony", "1"),
            ("content-type", "application/json"),
            ("cookie", cookie.as_str()),
        ];
        assert_eq!(checked(Method::POST, "/set", &good, false), None);
        let wrong = |name: &'static str, value: &str, why: Refused| {
            let pairs: Vec<_> = good.iter().map(|(n, v)| (*n, if *n == name { value } else { *v })).collect();
            assert_eq!(checked(Method::POST, "/set", &pairs, false), Some(why), "{name}: {value}");
        };
        for origin in [
            "http://localhost:4000",
            "http://127.0.0.1:4001",
            "null",
            "https://127.0.0.1:4000",
            "http://127.0.0.1:4000.a.com",
        ] {
            wrong("origin", origin, OTHER_ORIGIN);
        }
        for site in ["cross-site", "same-site", "none", ""] {
            wrong("sec-fetch-site", site, OTHER_ORIGIN);
        }
        wrong("x-lightharmony", "0", NO_HEADER);
        for kind in ["text/plain", "application/x-www-form-urlencoded", "application/json, text/plain"] {
            wrong("content-type", kind, NO_JSON);
        }
        for cookie in ["", "lightharmony-4000=", "lightharmony-4000=secret", "lightharmony-4001=x"] {
            wrong("cookie", cookie, NO_COOKIE);
        }
        for (name, why) in [("x-lightharmony", NO_HEADER), ("content-type", NO_JSON), ("cookie", NO_COOKIE)] {
            let pairs: Vec<_> = good.iter().filter(|(n, _)| *n != name).copied().collect();
            assert_eq!(checked(Method::POST, "/set", &pairs, false), Some(why), "no {name}");
        }
        for method in [Method::OPTIONS, Method::PUT, Method::DELETE, Method::PATCH, Method::TRACE] {
            assert_eq!(checked(method, "/set", &good, false), Some(METHOD));
        }
    }

    #[test]
    fn values_are_read_only_by_the_page_itself() {
        let door = Door::new("secret".to_owned(), 4000);
        let cookie = door.admit("secret").unwrap().split(';').next().unwrap().to_owned();
        let read = |site: &str, open: bool| {
            let pairs = [("host", "127.0.0.1:4000"), ("cookie", cookie.as_str()), ("sec-fetch-site", site)];
            checked(Method::GET, "/graph", &pairs, open)
        };
        assert_eq!((read("same-origin", false), read("none", false)), (None, None));
        assert_eq!(read("cross-site", false), Some(OTHER_ORIGIN));
        assert_eq!(
            read("same-site", false),
            Some(OTHER_ORIGIN),
            "another port of this machine is the same site"
        );
        assert_eq!(read("cross-site", true), None, "a link on another site may open the page");
        assert!(door.admit("Secret").is_none() && door.admit("").is_none());
        let set = door.admit("secret").unwrap();
        assert!(set.ends_with("; Path=/; HttpOnly; SameSite=Strict") && !set.contains("secret"), "{set}");
    }
}
