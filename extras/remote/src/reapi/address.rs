//! Addresses of servers.

use std::fmt;
use std::str::FromStr;

/// The address of a server: `grpc://HOST:PORT`, with an encrypted connection `grpcs://HOST:PORT`, and for servers with
/// several instances with `/INSTANCE` at the end.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Address {
    /// True if the connection is encrypted.
    pub encrypted: bool,
    /// Host and port, such as `127.0.0.1:8980` or `[::1]:8980`.
    pub authority: String,
    /// Name of the instance on the server; empty for servers with one instance.
    pub instance: String,
}

/// A text that is not the address of a server.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum AddressError {
    /// The text has another form.
    #[error(
        "`{0}` is not the address of a server; write `grpc://HOST:PORT`, such as `grpc://127.0.0.1:8980`, or \
         `grpcs://HOST:PORT` for an encrypted connection"
    )]
    Form(String),
}

impl Address {
    /// The address in the form that HTTP clients use.
    pub(crate) fn http(&self) -> String {
        format!("http{}://{}", if self.encrypted { "s" } else { "" }, self.authority)
    }

    /// True if the server runs on this machine.
    pub(crate) fn is_local(&self) -> bool {
        let host = self.authority.rsplit_once(':').map_or("", |(host, _)| host);
        host == "localhost" || host == "[::1]" || host.starts_with("127.")
    }
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let slash = if self.instance.is_empty() { "" } else { "/" };
        let scheme = if self.encrypted { "grpcs" } else { "grpc" };
        write!(f, "{scheme}://{}{slash}{}", self.authority, self.instance)
    }
}

impl FromStr for Address {
    type Err = AddressError;

    fn from_str(text: &str) -> Result<Self, AddressError> {
        let wrong = || AddressError::Form(text.to_owned());
        let encrypted = text.starts_with("grpcs://");
        let rest =
            text.strip_prefix("grpcs://").or_else(|| text.strip_prefix("grpc://")).ok_or_else(wrong)?;
        let (authority, instance) = rest.split_once('/').unwrap_or((rest, ""));
        let (host, port) = authority.rsplit_once(':').ok_or_else(wrong)?;
        let is_host = if let Some(inside) = host.strip_prefix('[').and_then(|host| host.strip_suffix(']')) {
            inside.parse::<std::net::Ipv6Addr>().is_ok()
        } else {
            let allowed = |c: char| c.is_ascii_alphanumeric() || matches!(c, '.' | '-' | '_');
            !host.is_empty() && host.chars().all(allowed)
        };
        let is_port = port.parse::<u16>().is_ok_and(|port| port > 0);
        // These words separate parts of the names of blobs, so the protocol forbids them in instances.
        let reserved = ["blobs", "uploads", "actions", "actionResults", "operations", "capabilities"];
        let instance = instance.trim_end_matches('/');
        let part = |part: &str| !part.is_empty() && !reserved.contains(&part);
        let is_instance = instance.is_empty()
            || instance.split('/').all(part) && instance.chars().all(|c| c.is_ascii_graphic());
        if !(is_host && is_port && is_instance) {
            return Err(wrong());
        }
        Ok(Self { encrypted, authority: authority.to_owned(), instance: instance.to_owned() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_read_and_mistakes_are_refused() {
        for (text, authority, instance) in [
            ("grpc://127.0.0.1:8980", "127.0.0.1:8980", ""),
            ("grpc://cache.farm:1/", "cache.farm:1", ""),
            ("grpc://[::1]:8980/main/b", "[::1]:8980", "main/b"),
            ("grpcs://cache.farm:443/main", "cache.farm:443", "main"),
        ] {
            let address: Address = text.parse().expect("an address");
            assert_eq!((address.authority.as_str(), address.instance.as_str()), (authority, instance));
            assert_eq!(address.encrypted, text.starts_with("grpcs"));
            assert_eq!(address.to_string().parse(), Ok(address));
        }
        for text in [
            "",
            "grpc://",
            "grpc://host",
            "grpc://host:0",
            "grpc://host:70000",
            "grpc://:80",
            "http://host:80",
            "grpc://user@host:80",
            "grpc://host:80/a/blobs",
            "grpc://host:80/a//b",
            "grpc://[zz]:80",
            "grpc://host:80/ä",
        ] {
            assert_eq!(text.parse::<Address>(), Err(AddressError::Form(text.to_owned())), "{text}");
        }
        for (text, is_local) in
            [("127.0.0.1", true), ("localhost", true), ("[::1]", true), ("128.0.0.1", false), ("host", false)]
        {
            let address: Address = format!("grpc://{text}:80").parse().expect("an address");
            assert_eq!(address.is_local(), is_local, "{text}");
        }
    }
}
