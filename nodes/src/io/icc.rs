//! ICC profiles (ICC.1:2022): which of them say no more than that codes are sRGB.

/// What a picture's profile is called where it is another one than sRGB, which is not used; `None` of sRGB.
pub fn other(profile: &[u8]) -> Option<String> {
    match description(profile) {
        Some(name) if name.contains("sRGB") => None,
        Some(name) => Some(format!("an ICC profile (`{name}`)")),
        None => Some("an ICC profile".to_owned()),
    }
}

/// The big-endian number of four bytes at `at`.
fn number(bytes: &[u8], at: usize) -> Option<usize> {
    let four = bytes.get(at..at.checked_add(4)?)?;
    four.try_into().ok().map(|four| u32::from_be_bytes(four) as usize)
}

/// The tag `desc` (9.2.41): the first of the names of version 4 (`mluc`), or the one of version 2.
fn description(profile: &[u8]) -> Option<String> {
    let tags = profile.get(132..)?.as_chunks::<12>().0;
    let tag = tags.iter().take(number(profile, 128)?).find(|tag| tag.starts_with(b"desc"))?;
    let (start, size) = (number(tag, 4)?, number(tag, 8)?);
    let tag = profile.get(start..start.checked_add(size)?)?;
    let (from, length, wide) = match tag.get(..4)? {
        b"mluc" => (number(tag, 24)?, number(tag, 20)?, true),
        b"desc" => (12, number(tag, 8)?, false),
        _ => return None,
    };
    let text = tag.get(from..from.checked_add(length)?)?;
    let text = if wide {
        let units: Vec<u16> = text.as_chunks().0.iter().map(|two| u16::from_be_bytes(*two)).collect();
        String::from_utf16_lossy(&units)
    } else {
        String::from_utf8_lossy(text).into_owned()
    };
    let text: String = text.chars().filter(|c| !c.is_control()).take(64).collect();
    Some(text).filter(|text| !text.is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A profile of one tag.
    fn profile(tag: &[u8]) -> Vec<u8> {
        let mut bytes = vec![0; 128];
        bytes.extend(1_u32.to_be_bytes());
        bytes.extend(b"desc");
        bytes.extend(144_u32.to_be_bytes());
        bytes.extend((tag.len() as u32).to_be_bytes());
        bytes.extend(tag);
        bytes
    }

    fn old(name: &str) -> Vec<u8> {
        let length = (name.len() as u32 + 1).to_be_bytes();
        profile(&[b"desc\0\0\0\0", &length[..], name.as_bytes(), b"\0"].concat())
    }

    fn new(name: &str) -> Vec<u8> {
        let text: Vec<u8> = name.encode_utf16().flat_map(u16::to_be_bytes).collect();
        let head = [1_u32, 12].map(u32::to_be_bytes).concat();
        let place = [text.len() as u32, 28].map(u32::to_be_bytes).concat();
        profile(&[b"mluc\0\0\0\0", &head[..], b"enUS", &place, &text].concat())
    }

    // Mutation: `contains` to `is_empty`.
    #[test]
    fn srgb_alone_is_nothing_to_tell() {
        for make in [old, new] {
            assert_eq!(other(&make("sRGB IEC61966-2.1")), None);
            assert_eq!(other(&make("Display P3")).as_deref(), Some("an ICC profile (`Display P3`)"));
            let whole = make("sRGB built-in");
            for cut in 0..whole.len() {
                assert!(other(&whole[..cut]).is_some(), "{cut} bytes say nothing");
            }
        }
    }
}
