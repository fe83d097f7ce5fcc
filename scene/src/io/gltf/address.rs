//! Addresses of buffers and pictures: embedded data, or relative paths.

use crate::error::Error;
use crate::io::base64;

/// Decodes a `data:` address. Returns `None` for other addresses.
pub(super) fn inline(name: &str, uri: &str) -> Option<Result<Vec<u8>, Error>> {
    let data = uri.strip_prefix("data:")?;
    Some(match data.split_once(";base64,") {
        Some((_, text)) => {
            let bytes = base64::decode(text);
            bytes.ok_or_else(|| Error::format(name, "a data URI is not valid base64"))
        }
        None => Err(Error::unsupported(name, "a data URI without base64")),
    })
}

/// The path that an address names, with escapes such as `%20` decoded.
pub(crate) fn path(name: &str, uri: &str) -> Result<String, Error> {
    let mut out = Vec::with_capacity(uri.len());
    let mut rest = uri.bytes();
    while let Some(byte) = rest.next() {
        let digit = |b: Option<u8>| b.and_then(|b| char::from(b).to_digit(16));
        out.push(match byte {
            b'%' => match (digit(rest.next()), digit(rest.next())) {
                (Some(high), Some(low)) => (high * 16 + low) as u8,
                _ => {
                    return Err(Error::format(
                        name,
                        format!("the address `{uri}` contains an invalid escape (`%`)"),
                    ));
                }
            },
            other => other,
        });
    }
    // Exporters of Windows separate folders by back slashes.
    let path = String::from_utf8(out)
        .map_err(|_| Error::format(name, format!("the address `{uri}` is not UTF-8")))?
        .replace('\\', "/");
    let drive = path.as_bytes().get(1) == Some(&b':');
    if path.contains("://") || path.starts_with('/') || drive || path.contains('\0') {
        return Err(Error::unsupported(
            name,
            format!(
                "the address `{uri}`; only relative paths are read, such as `textures/wood.png` or `../wood.png`"
            ),
        ));
    }
    Ok(path)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_decode() {
        assert_eq!(path("a", "my%20chair.bin").ok().as_deref(), Some("my chair.bin"));
        for (slashes, plain) in [
            ("maps\\c.png", "maps/c.png"),
            ("maps%5Cc.png", "maps/c.png"),
            (".\\maps\\deep\\c%20d.png", "./maps/deep/c d.png"),
            ("..\\c.png", "../c.png"),
        ] {
            assert_eq!(path("a", slashes).ok().as_deref(), Some(plain));
        }
        for refused in ["https://x/y.bin", "/etc/passwd", "a%2", "c:\\x", "\\\\server\\x", "\\x", "C:/x"] {
            assert!(path("a", refused).is_err(), "{refused}");
        }
        // Files of a parent folder are read, since exporters with a folder of textures refer to them. The message
        // says so.
        assert_eq!(path("a", "../wood.png").ok().as_deref(), Some("../wood.png"));
        let text = path("a", "/etc/passwd").err().map(|e| e.to_string()).unwrap_or_default();
        assert!(text.contains("only relative paths are read") && text.contains("`../wood.png`"), "{text}");
    }
}
