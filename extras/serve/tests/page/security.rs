//! Every rule by which requests of other sites and other local servers are refused.

use std::net::TcpStream;

use crate::lab::{GRAPH, Lab, digest_of};

fn edit(text: &str) -> String {
    serde_json::json!({"digest": digest_of(text), "node": "pose", "field": "yaw_deg", "value": "99.0"})
        .to_string()
}

/// A POST with the given headers after `Host`.
fn post(lab: &Lab, path: &str, headers: &str, body: &str) -> u16 {
    let length = body.len();
    let request = format!(
        "POST {path} HTTP/1.1\r\n{headers}Content-Length: {length}\r\nConnection: close\r\n\r\n{body}"
    );
    lab.raw(&request).status
}

#[test]
fn other_hosts_are_refused_before_everything_else() {
    let lab = Lab::new(GRAPH);
    let (cookie, port) = (&lab.cookie, lab.port);
    let get = |host: &str| {
        let request = format!("GET /graph HTTP/1.1\r\n{host}Cookie: {cookie}\r\nConnection: close\r\n\r\n");
        lab.raw(&request).status
    };
    for host in ["127.0.0.1", "localhost", "[::1]"] {
        assert_eq!(get(&format!("Host: {host}:{port}\r\n")), 200, "{host}");
    }
    for host in ["attacker.com", "localhost.attacker.com", "127.0.0.1.attacker.com", "0.0.0.0", "127.0.0.2"] {
        assert_eq!(get(&format!("Host: {host}:{port}\r\n")), 403, "{host}");
        assert_eq!(get(&format!("Host: {host}\r\n")), 403, "{host}");
    }
    assert_eq!(get(&format!("Host: localhost:{}\r\n", port ^ 1)), 403);
    assert_eq!(get("Host: localhost\r\n"), 403);
    let page = format!("GET / HTTP/1.1\r\nHost: attacker.com:{port}\r\nConnection: close\r\n\r\n");
    assert_eq!(lab.raw(&page).status, 403, "not even the page itself");
    let absolute = format!(
        "GET http://attacker.com:{port}/graph HTTP/1.1\r\nHost: localhost:{port}\r\nCookie: {cookie}\r\nConnection: close\r\n\r\n"
    );
    assert_eq!(lab.raw(&absolute).status, 403);
    let none = lab.raw(&format!("GET /graph HTTP/1.0\r\nCookie: {cookie}\r\n\r\n")).status;
    assert_eq!(none, 403, "HTTP/1.0 without a host");
}

#[test]
fn without_the_cookie_nothing_private_is_given() {
    let lab = Lab::new(GRAPH);
    let value = lab.idle()["nodes"]["view"]["outputs"][0]["digest"].as_str().unwrap().to_owned();
    let value = format!("/value/{value}");
    for path in [
        "/events",
        "/graph",
        "/place",
        "/trade",
        "/references",
        "/graphs",
        "/objects",
        "/difference/0/0/0/0",
        "/splats/0",
        value.as_str(),
        &format!("{value}/0.png"),
        &format!("{value}/0.f32"),
        "/anything",
    ] {
        for cookie in [
            "",
            "Cookie: lightharmony=1\r\n",
            &format!("Cookie: lightharmony-{}={}\r\n", lab.port, lab.token),
        ] {
            let request =
                format!("GET {path} HTTP/1.1\r\nHost: {}\r\n{cookie}Connection: close\r\n\r\n", lab.host());
            let response = lab.raw(&request);
            assert_eq!(response.status, 401, "{path}");
            assert!(!String::from_utf8_lossy(&response.body).contains("pose"));
        }
    }
    let host = lab.host();
    let good = format!(
        "Host: {host}\r\nOrigin: http://{host}\r\nX-Lightharmony: 1\r\nContent-Type: application/json\r\n"
    );
    for path in ["/set", "/try", "/plan", "/undo", "/redo", "/ground", "/preset", "/start", "/up", "/add"] {
        assert_eq!(post(&lab, path, &good, &edit(GRAPH)), 401, "{path}");
    }
    assert_eq!(lab.text(), GRAPH);
    for token in ["", "0", &lab.token.to_uppercase(), &lab.token[1..], &format!("{} ", lab.token)] {
        let body = serde_json::json!({"token": token}).to_string();
        let expected = if *token == lab.token { 200 } else { 403 };
        assert_eq!(post(&lab, "/session", &good, &body), expected, "{token}");
    }
    let page = lab.raw(&format!("GET / HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n"));
    assert_eq!(page.status, 200, "the page itself contains nothing private");
    assert!(!String::from_utf8_lossy(&page.body).contains(&lab.token));
}

#[test]
fn the_cookie_is_strict_and_is_not_the_token() {
    let lab = Lab::new(GRAPH);
    let admitted = lab.post("/session", &serde_json::json!({"token": lab.token}).to_string());
    let cookie = admitted.header("set-cookie").unwrap();
    let rest: Vec<&str> = cookie.split("; ").skip(1).collect();
    assert_eq!(rest, ["Path=/", "HttpOnly", "SameSite=Strict"]);
    assert!(cookie.starts_with(&format!("lightharmony-{}=", lab.port)) && !cookie.contains(&lab.token));
    assert!(lab.token.len() == 32 && lab.token.bytes().all(|byte| byte.is_ascii_hexdigit()), "128 bits");
}

#[test]
fn a_change_from_another_origin_is_refused() {
    let lab = Lab::new(GRAPH);
    lab.idle();
    let (host, cookie) = (lab.host(), format!("Cookie: {}\r\n", lab.cookie));
    let good = format!(
        "Host: {host}\r\n{cookie}Origin: http://{host}\r\nSec-Fetch-Site: same-origin\r\nX-Lightharmony: 1\r\nContent-Type: application/json\r\n"
    );
    let wrong = |from: &str, to: &str| {
        assert!(good.contains(from), "{from}");
        post(&lab, "/set", &good.replace(from, to), &edit(GRAPH))
    };
    let origin = format!("Origin: http://{host}\r\n");
    for other in [
        "http://attacker.com",
        "null",
        &format!("https://{host}"),
        &format!("http://localhost:{}", lab.port),
        &format!("http://{host}.attacker.com"),
        &format!("http://127.0.0.1:{}", lab.port ^ 1),
    ] {
        assert_eq!(wrong(&origin, &format!("Origin: {other}\r\n")), 403, "{other}");
    }
    for site in ["cross-site", "same-site", "none"] {
        assert_eq!(wrong("Sec-Fetch-Site: same-origin", &format!("Sec-Fetch-Site: {site}")), 403, "{site}");
    }
    assert_eq!(wrong("X-Lightharmony: 1\r\n", ""), 403);
    for kind in ["text/plain", "application/x-www-form-urlencoded", "multipart/form-data"] {
        assert_eq!(wrong("application/json", kind), 415, "{kind}");
    }
    assert_eq!(lab.text(), GRAPH, "nothing was written");
    assert_eq!(post(&lab, "/set", &good, &edit(GRAPH)), 200);
    for site in ["cross-site", "same-site"] {
        let request = format!(
            "GET /graph HTTP/1.1\r\nHost: {host}\r\n{cookie}Sec-Fetch-Site: {site}\r\nConnection: close\r\n\r\n"
        );
        assert_eq!(lab.raw(&request).status, 403, "a read, {site}");
    }
}

#[test]
fn a_preflight_is_never_granted_and_other_methods_are_refused() {
    let lab = Lab::new(GRAPH);
    let (host, cookie) = (lab.host(), &lab.cookie);
    for method in ["OPTIONS", "PUT", "DELETE", "PATCH", "TRACE"] {
        let request = format!(
            "{method} /set HTTP/1.1\r\nHost: {host}\r\nCookie: {cookie}\r\nOrigin: http://attacker.com\r\nAccess-Control-Request-Method: POST\r\nAccess-Control-Request-Headers: x-lightharmony\r\nConnection: close\r\n\r\n"
        );
        let response = lab.raw(&request);
        assert_eq!(response.status, 405, "{method}");
        assert!(!response.headers.iter().any(|(name, _)| name.starts_with("access-control")), "{method}");
    }
    for path in ["/set", "/try", "/plan", "/undo", "/redo", "/session", "/preset", "/start", "/up", "/add"] {
        assert!(matches!(lab.get(path).status, 404 | 405), "{path} by GET");
    }
    assert_eq!(lab.text(), GRAPH);
}

#[test]
fn every_response_has_the_strict_headers() {
    let lab = Lab::new(GRAPH);
    let other = lab.raw("GET / HTTP/1.1\r\nHost: attacker.com\r\nConnection: close\r\n\r\n");
    for response in [lab.get("/"), lab.get("/assets/page.js"), lab.get("/graph"), lab.get("/nothing"), other]
    {
        let policy = response.header("content-security-policy").unwrap();
        assert!(policy.starts_with("default-src 'none'; script-src 'self'; style-src 'self';"), "{policy}");
        assert!(policy.contains("frame-ancestors 'none'") && !policy.contains("unsafe"), "{policy}");
        assert_eq!(response.header("x-content-type-options"), Some("nosniff"));
        assert_eq!(response.header("cross-origin-resource-policy"), Some("same-origin"));
        assert_eq!(response.header("referrer-policy"), Some("no-referrer"));
        assert_eq!(response.header("cache-control"), Some("no-store"));
        assert!(!response.headers.iter().any(|(name, _)| name.starts_with("access-control")));
    }
}

#[test]
fn sizes_are_bounded() {
    let lab = Lab::new(GRAPH);
    let long = "x".repeat(1 << 20);
    assert_eq!(lab.post("/set", &long).status, 413);
    assert_eq!(lab.post("/session", &long).status, 413);
    let response = lab.set("pose", "yaw_deg", &[], Some(&format!("\"{}\"", "x".repeat(20_000))));
    assert_eq!(response.status, 422, "{response:?}");
    let path =
        format!("GET /{} HTTP/1.1\r\nHost: {}\r\nConnection: close\r\n\r\n", "x".repeat(1 << 20), lab.host());
    assert!(matches!(lab.raw(&path).status, 0 | 400..=499), "an address of a megabyte");
    for body in ["", "{", "[]", "null", "{\"digest\": 1}", "{\"path\": \"/etc/passwd\"}"] {
        assert_eq!(lab.post("/set", body).status, 400, "{body}");
    }
    assert_eq!(lab.text(), GRAPH);
    assert_eq!(lab.get("/").status, 200, "it still answers");
}

#[test]
fn no_request_contains_a_path() {
    let lab = Lab::new(GRAPH);
    lab.idle();
    for path in [
        "/../graph.ron",
        "/assets/../../graph.ron",
        "/assets/%2e%2e/graph.ron",
        "/value/..%2f..%2fgraph.ron",
        "/value/graph.ron/0.png",
        "/assets//etc/passwd",
    ] {
        let response = lab.get(path);
        assert_eq!(response.status, 404, "{path}");
    }
    let response = lab.set("save", "path", &[], Some("\"/tmp/elsewhere.png\""));
    assert_eq!(response.status, 422);
    assert!(response.json()["why"].as_str().unwrap().contains("names a file"));
    let unknown = "0".repeat(64);
    assert_eq!(lab.get(&format!("/value/{unknown}")).status, 404);
}

#[test]
fn the_server_listens_on_loopback_only() {
    let lab = Lab::new(GRAPH);
    // Any other address of this machine; there may be none in a sandbox.
    let socket = std::net::UdpSocket::bind("0.0.0.0:0").unwrap();
    if socket.connect("192.0.2.1:9").is_ok()
        && let Ok(own) = socket.local_addr()
        && !own.ip().is_loopback()
        && !own.ip().is_unspecified()
    {
        assert!(TcpStream::connect((own.ip(), lab.port)).is_err(), "{}", own.ip());
    }
    let tcp = std::fs::read_to_string("/proc/net/tcp").unwrap_or_default();
    let listening = tcp.lines().filter(|line| line.contains(&format!(":{:04X} 00000000:0000 0A", lab.port)));
    let addresses: Vec<&str> = listening.filter_map(|line| line.split_whitespace().nth(1)).collect();
    assert!(addresses.iter().all(|address| address.starts_with("0100007F:")), "{addresses:?}");
}
