//! Requests: whether they may come in, and what is answered.

use std::net::IpAddr;

use super::ServerOptions;

/// Longest request head.
pub(super) const MAX_HEAD: usize = 8 << 10;
const MAX_HEADERS: usize = 64;

/// What becomes of a request.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Reply {
    /// The page, or a part of it: its place in the list.
    Part { index: usize, head_only: bool, gzip: bool },
    /// Another place.
    Moved(String),
    /// It becomes a WebSocket, by the answer to this key.
    Upgrade { key: String },
    /// Refused.
    Error(u16, &'static str),
}

const BAD: Reply = Reply::Error(400, "Bad Request");
pub(super) const NOT_FOUND: Reply = Reply::Error(404, "Not Found");
const FORBIDDEN: Reply = Reply::Error(403, "Forbidden");

/// What becomes of the request whose head is at the beginning of `bytes`, and how long the head is; none while it is
/// incomplete.
pub(super) fn reply(bytes: &[u8], options: &ServerOptions) -> Option<(Reply, usize)> {
    let mut headers = [httparse::EMPTY_HEADER; MAX_HEADERS];
    let mut request = httparse::Request::new(&mut headers);
    match request.parse(bytes) {
        Ok(httparse::Status::Complete(length)) => Some((answer(&request, options), length)),
        Ok(httparse::Status::Partial) if bytes.len() < MAX_HEAD => None,
        Ok(httparse::Status::Partial) => {
            Some((Reply::Error(431, "Request Header Fields Too Large"), bytes.len()))
        }
        Err(_) => Some((BAD, bytes.len())),
    }
}

fn answer(request: &httparse::Request<'_, '_>, options: &ServerOptions) -> Reply {
    let (Some(method), Some(target)) = (request.method, request.path) else { return BAD };
    // A field that comes twice is as good as none: who reads which would be open.
    let field = |name: &str| {
        let mut found = request.headers.iter().filter(|header| header.name.eq_ignore_ascii_case(name));
        let value = found.next().and_then(|header| std::str::from_utf8(header.value).ok());
        value.filter(|_| found.next().is_none())
    };
    let Some(host) = field("host").filter(|host| options.takes_host(host)) else { return FORBIDDEN };
    if method != "GET" && method != "HEAD" {
        return Reply::Error(405, "Method Not Allowed");
    }
    let (path, query) = target.split_once('?').unwrap_or((target, ""));
    let path = path.strip_prefix('/').unwrap_or(path);
    if path.strip_suffix("/live") == Some(options.room.as_str()) {
        let has_origin = request.headers.iter().any(|header| header.name.eq_ignore_ascii_case("origin"));
        let own = field("origin").is_some_and(|origin| is_own(origin, host));
        if has_origin && !own || !options.takes_token(token(query)) {
            return FORBIDDEN;
        }
        let upgrades = field("upgrade").is_some_and(|upgrade| upgrade.eq_ignore_ascii_case("websocket"));
        let right = upgrades && field("sec-websocket-version") == Some("13") && method == "GET";
        return match field("sec-websocket-key").filter(|_| right) {
            Some(key) if is_key(key) => Reply::Upgrade { key: key.to_owned() },
            Some(_) => BAD,
            None => Reply::Error(426, "Upgrade Required"),
        };
    }
    if path.is_empty() {
        return Reply::Moved(format!("/{}", options.room));
    }
    // The page names its files as its neighbours.
    let name = if path == options.room { "" } else { path };
    match options.parts.iter().position(|part| part.name == name) {
        Some(index) => Reply::Part { index, head_only: method == "HEAD", gzip: takes_gzip(request.headers) },
        None => NOT_FOUND,
    }
}

/// Whether an answer may be gzipped (RFC 9110, 12.5.3): among the codings that are taken gzip is named, or any, and not with
/// the weight 0.
fn takes_gzip(headers: &[httparse::Header<'_>]) -> bool {
    let fields = headers.iter().filter(|header| header.name.eq_ignore_ascii_case("accept-encoding"));
    let codings =
        fields.filter_map(|header| std::str::from_utf8(header.value).ok()).flat_map(|v| v.split(','));
    let codings = codings.map(|coding| coding.split_once(';').unwrap_or((coding, "")));
    let weight = |wanted: &str| {
        let mut named = codings.clone().filter(|(name, _)| name.trim().eq_ignore_ascii_case(wanted));
        named.next().map(|(_, weight)| match weight.trim().split_once('=') {
            None => weight.trim().is_empty(),
            Some((_, value)) => value.trim().parse().is_ok_and(|weight: f32| weight > 0.0),
        })
    };
    weight("gzip").or_else(|| weight("*")).unwrap_or(false)
}

/// Whether a WebSocket key is what it has to be (RFC 6455, 4.1): 16 bytes as base64.
fn is_key(key: &str) -> bool {
    let digit = |b: u8| b.is_ascii_alphanumeric() || b == b'+' || b == b'/';
    key.strip_suffix("==").is_some_and(|digits| digits.len() == 22 && digits.bytes().all(digit))
}

/// Whether an origin is the page's own, where requests name this host.
fn is_own(origin: &str, host: &str) -> bool {
    let name = origin.strip_prefix("http://").or_else(|| origin.strip_prefix("https://"));
    name.is_some_and(|name| name.eq_ignore_ascii_case(host))
}

/// The token in a query; empty where there is none.
fn token(query: &str) -> &str {
    query.split('&').find_map(|pair| pair.strip_prefix("token=")).unwrap_or_default()
}

/// A host without its port.
pub(super) fn without_port(host: &str) -> &str {
    match host.rsplit_once(':') {
        Some((name, port)) if !port.is_empty() && port.bytes().all(|b| b.is_ascii_digit()) => name,
        _ => host,
    }
}

/// Whether a name means the loopback interface.
pub(super) fn is_loopback(name: &str) -> bool {
    address(name).is_some_and(|address| address.is_loopback()) || name.eq_ignore_ascii_case("localhost")
}

/// The address that a name is, so that nobody else's name server can have given it; of IPv6 in brackets.
pub(super) fn address(name: &str) -> Option<IpAddr> {
    match name.strip_prefix('[').and_then(|name| name.strip_suffix(']')) {
        Some(inside) => inside.parse().ok().map(IpAddr::V6),
        None => name.parse().ok().map(IpAddr::V4),
    }
}

/// Whether a host is the one of this name, an address of IPv6 with brackets or without.
pub(super) fn is_named(host: &str, name: &str) -> bool {
    let bare = |name: &str| name.trim_start_matches('[').trim_end_matches(']').to_ascii_lowercase();
    bare(host) == bare(name)
}

#[cfg(test)]
mod tests {
    use super::super::Part;
    use super::*;

    fn options(token: &str, loopback: bool) -> ServerOptions {
        let parts = vec![Part::new("", "text/html", "page"), Part::new("a.js", "text/javascript", "1")];
        let bind = if loopback { "127.0.0.1:0" } else { "0.0.0.0:0" };
        ServerOptions {
            token: token.into(),
            ..ServerOptions::new(bind.parse().unwrap()).with_room("r").with_parts(parts)
        }
    }

    fn ask(options: &ServerOptions, text: &str) -> Reply {
        reply(text.as_bytes(), options).unwrap().0
    }

    #[test]
    fn pages_and_their_parts() {
        let options = options("", true);
        let get = |path: &str| ask(&options, &format!("GET {path} HTTP/1.1\r\nHost: localhost:1\r\n\r\n"));
        assert_eq!(get("/r"), Reply::Part { index: 0, head_only: false, gzip: false });
        assert_eq!(get("/a.js?x"), Reply::Part { index: 1, head_only: false, gzip: false });
        assert_eq!(get("/"), Reply::Moved("/r".into()));
        assert_eq!(get("/q"), Reply::Error(404, "Not Found"));
        assert_eq!(get("/../etc/passwd"), Reply::Error(404, "Not Found"));
        assert!(reply(b"GET / HTTP/1.1\r\nHost: loc", &options).is_none());
        let long = format!("GET / HTTP/1.1\r\nX: {}", "y".repeat(MAX_HEAD));
        assert!(matches!(ask(&options, &long), Reply::Error(431, _)));
        assert_eq!(
            ask(&options, "POST /r HTTP/1.1\r\nHost: localhost\r\n\r\n"),
            Reply::Error(405, "Method Not Allowed")
        );
        assert_eq!(ask(&options, "\x16\x03\x01\r\n\r\n"), BAD);
    }

    #[test]
    fn what_may_be_gzipped() {
        let options = options("", true);
        for (fields, may) in [
            ("", false),
            ("Accept-Encoding: gzip, deflate, br, zstd\r\n", true),
            ("Accept-Encoding: br;q=1.0, GZIP;q=0.001\r\n", true),
            ("Accept-Encoding: br\r\naccept-encoding: gzip\r\n", true),
            ("Accept-Encoding: *\r\n", true),
            ("Accept-Encoding:\r\n", false),
            ("Accept-Encoding: identity\r\n", false),
            ("Accept-Encoding: xgzip, gzipx\r\n", false),
            ("Accept-Encoding: gzip; q=0\r\n", false),
            ("Accept-Encoding: *, gzip;q=0.000\r\n", false),
            ("Accept-Encoding: *;q=0\r\n", false),
            ("Accept-Encoding: gzip;q=much\r\n", false),
        ] {
            let found = ask(&options, &format!("HEAD /r HTTP/1.1\r\nHost: localhost\r\n{fields}\r\n"));
            assert_eq!(found, Reply::Part { index: 0, head_only: true, gzip: may }, "{fields}");
        }
    }

    #[test]
    fn hosts_and_origins_of_others() {
        for (loopback, host, lets_in) in [
            (true, "127.0.0.1:4000", true),
            (true, "LocalHost", true),
            (true, "127.0.0.2:4000", true),
            (true, "[::1]:4000", true),
            (true, "::1", false),
            (true, "[127.0.0.1]:4000", false),
            (true, "192.168.1.2:4000", false),
            (true, "evil.example", false),
            (true, "127.0.0.1.evil.example", false),
            (false, "192.168.1.2:4000", true),
            (false, "[fe80::1]:4000", true),
            (false, "evil.example:4000", false),
            (false, "localhost:80:1x", false),
        ] {
            let found = ask(&options("", loopback), &format!("GET /r HTTP/1.1\r\nHost: {host}\r\n\r\n"));
            assert_eq!(matches!(found, Reply::Part { .. }), lets_in, "{host}: {found:?}");
        }
        let named = |own: &str, host: &str| {
            let options = options("", true).with_hosts(vec![own.to_owned()]);
            let found = ask(&options, &format!("GET /r HTTP/1.1\r\nHost: {host}\r\n\r\n"));
            matches!(found, Reply::Part { .. })
        };
        assert!(named("hands.example", "Hands.Example:4000") && !named("hands.example", "example"));
        assert!(named("[fd00::1]", "[fd00::1]:4000") && named("fd00::1", "[FD00::1]"));
        assert!(!named("fd00::1", "[fd00::2]:4000"));
        let twice = "GET /r HTTP/1.1\r\nHost: localhost\r\nHost: localhost\r\n\r\n";
        assert_eq!(ask(&options("", true), twice), FORBIDDEN);
    }

    const KEY: &str = "dGhlIHNhbXBsZSBub25jZQ==";

    fn upgrade(query: &str, origin: &str, key: &str) -> String {
        format!(
            "GET /r/live{query} HTTP/1.1\r\nHost: 10.0.0.1:4000\r\n{origin}Upgrade: websocket\r\n\
             Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: {key}\r\n\r\n"
        )
    }

    #[test]
    fn keys_are_sixteen_bytes() {
        let options = options("", false);
        assert_eq!(ask(&options, &upgrade("", "", KEY)), Reply::Upgrade { key: KEY.into() });
        for key in [
            "",
            "k",
            "a2V5",
            "dGhlIHNhbXBsZSBub25jZQ",
            "dGhlIHNhbXBsZSBub25j====",
            "dGhlIHNhbXBsZSBub25 ZQ==",
        ] {
            assert_eq!(ask(&options, &upgrade("", "", key)), BAD, "{key}");
        }
    }

    #[test]
    fn sockets_take_the_token_and_their_own_origin() {
        let options = options("secret", false);
        let ask = |query: &str, origin: &str| ask(&options, &upgrade(query, origin, KEY));
        let upgrade = Reply::Upgrade { key: KEY.into() };
        assert_eq!(ask("?token=secret", ""), upgrade);
        assert_eq!(ask("?a=1&token=secret", "Origin: http://10.0.0.1:4000\r\n"), upgrade);
        for (query, origin) in [
            ("", ""),
            ("?token=", ""),
            ("?token=secre", ""),
            ("?token=secret1", ""),
            ("?token=secret", "Origin: http://evil.example\r\n"),
            ("?token=secret", "Origin: null\r\n"),
            ("?token=secret", "Origin: http://10.0.0.1:4001\r\n"),
            ("?token=secret", "Origin: http://10.0.0.1:4000\r\nOrigin: http://10.0.0.1:4000\r\n"),
        ] {
            assert_eq!(ask(query, origin), FORBIDDEN, "{query} {origin}");
        }
    }
}
