//! The order of the attributes of a file.

/// Number of bytes before the first attribute: the magic number and the version.
const START: usize = 8;

/// Sorts the attributes of the only header of a file by name, as the library of OpenEXR writes them. The length of the
/// header, and with it the offsets of the blocks, stay the same. A file whose header cannot be read stays as it is.
pub(super) fn sort_attributes(file: &mut [u8]) {
    let Some(ends) = ends(file) else { return };
    let starts = [START].into_iter().chain(ends.iter().copied());
    let mut attributes: Vec<Vec<u8>> =
        starts.zip(&ends).map(|(start, &end)| file[start..end].to_vec()).collect();
    attributes.sort_by(|a, b| text(a).cmp(&text(b)));
    let sorted = attributes.concat();
    file[START..START + sorted.len()].copy_from_slice(&sorted);
}

/// End of each attribute of the first header; `None` if it is not complete.
fn ends(file: &[u8]) -> Option<Vec<usize>> {
    let (mut at, mut ends) = (START, Vec::new());
    // An attribute is a name, a type, the length of its value, and the value; an empty name ends the header.
    while *file.get(at)? != 0 {
        for _ in 0..2 {
            at += text(file.get(at..)?)?.len() + 1;
        }
        let length = u32::from_le_bytes(file.get(at..at + 4)?.try_into().ok()?);
        at += 4 + length as usize;
        ends.push(at);
    }
    Some(ends)
}

/// The bytes before the first zero; `None` if there is no zero.
fn text(bytes: &[u8]) -> Option<&[u8]> {
    bytes.iter().position(|byte| *byte == 0).map(|end| &bytes[..end])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(attributes: &[(&str, &[u8])]) -> Vec<u8> {
        let mut file = vec![7; START];
        for (name, value) in attributes {
            for text in [name, "string"] {
                file.extend(text.bytes().chain([0]));
            }
            file.extend((value.len() as u32).to_le_bytes());
            file.extend(*value);
        }
        file.extend([0, 1, 2, 3]);
        file
    }

    /// This test fails if the value is not moved with its name.
    #[test]
    fn attributes_are_sorted_by_name() {
        let mut unsorted = file(&[("b", b"long value\0"), ("a/c", b""), ("a", b"1")]);
        sort_attributes(&mut unsorted);
        assert_eq!(unsorted, file(&[("a", b"1"), ("a/c", b""), ("b", b"long value\0")]));
    }

    #[test]
    fn a_broken_header_stays() {
        let mut broken = file(&[("b", b"1"), ("a", b"2")]);
        broken.truncate(20);
        let before = broken.clone();
        sort_attributes(&mut broken);
        assert_eq!(broken, before);
    }
}
