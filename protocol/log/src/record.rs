//! Parses records. The lengths of texts are checked first, because mcap's parser allocates any length that it reads,
//! up to four gigabytes for a wrong length field.

use mcap::records::{Record, op};

/// Maximum length of a record, in bytes: the most that a damaged length can make a reader allocate.
pub(super) const LONGEST_RECORD: usize = 64 << 20;

/// Maximum length of a record that declares something, in bytes. Ours have some thousand; in memory they become
/// several times as long.
pub(super) const LONGEST_DECLARATION: usize = 1 << 20;

/// The reason why a record is not accepted.
pub(super) enum Trouble {
    /// It is damaged.
    Damage(String),
    /// It is intact, but not ours.
    Foreign(String),
}

/// Parses the content of a record.
///
/// # Errors
/// When it does not follow the format, or a text in it is longer than the record.
pub(super) fn parse(kind: u8, content: &[u8]) -> Result<Record<'_>, String> {
    if !texts_fit(kind, content) {
        return Err("a text in it is longer than the record".to_owned());
    }
    mcap::parse_record(kind, content).map_err(|cause| cause.to_string())
}

/// A part of a record. The parts of a kind end with its last text.
enum Part {
    Bytes(usize),
    /// A length of four bytes, and that many bytes.
    Text,
    /// A length of four bytes, and that many bytes of pairs of texts.
    Map,
}

/// Returns whether the texts of a record lie within it.
fn texts_fit(kind: u8, content: &[u8]) -> bool {
    use Part::{Bytes, Map, Text};
    let parts: &[Part] = match kind {
        op::HEADER => &[Text, Text],
        op::SCHEMA => &[Bytes(2), Text, Text],
        op::CHANNEL => &[Bytes(4), Text, Text, Map],
        op::CHUNK => &[Bytes(28), Text],
        // A map of numbers starts with its length, as a text does.
        op::CHUNK_INDEX => &[Bytes(32), Text, Bytes(8), Text],
        op::ATTACHMENT => &[Bytes(16), Text, Text],
        op::ATTACHMENT_INDEX => &[Bytes(40), Text, Text],
        op::METADATA => &[Text, Map],
        op::METADATA_INDEX => &[Bytes(16), Text],
        _ => &[],
    };
    let mut rest = Rest(content);
    parts.iter().all(|part| {
        let measured = match *part {
            Bytes(count) => rest.bytes(count),
            Text => rest.text(),
            Map => rest.map(),
        };
        measured.is_some()
    })
}

/// The part of a record that has not been checked yet.
struct Rest<'a>(&'a [u8]);

impl<'a> Rest<'a> {
    fn bytes(&mut self, count: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(count)?;
        self.0 = rest;
        Some(taken)
    }

    fn text(&mut self) -> Option<&'a [u8]> {
        let length = self.bytes(4)?.try_into().expect("four bytes were taken");
        self.bytes(u32::from_le_bytes(length) as usize)
    }

    fn map(&mut self) -> Option<&'a [u8]> {
        let all = self.text()?;
        let mut pairs = Rest(all);
        while !pairs.0.is_empty() {
            pairs.text()?;
            pairs.text()?;
        }
        Some(all)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn text(bytes: &[u8]) -> Vec<u8> {
        [&(bytes.len() as u32).to_le_bytes()[..], bytes].concat()
    }

    #[test]
    fn a_text_longer_than_its_record_is_refused_before_there_is_room_for_it() {
        let pair = [text(b"key"), text(b"value")].concat();
        let metadata = [text(b"name"), text(&pair)].concat();
        assert!(parse(op::METADATA, &metadata).is_ok());
        let channel = [&[1, 0, 2, 0][..], &text(b"/topic"), &text(b"protobuf"), &text(&pair)];
        assert!(parse(op::CHANNEL, &channel.concat()).is_ok());
        // The length of each text in turn.
        for at in [0, 8, 12, 19] {
            refused_without_room(op::METADATA, &metadata, at);
        }
    }

    #[test]
    fn no_kind_of_record_gets_room_for_a_text_longer_than_itself() {
        let texts = [text(b"first"), text(b"second")].concat();
        let index = [&[0; 32][..], &text(&[0; 10]), &[0; 8], &text(b"lz4"), &[0; 16]].concat();
        for (kind, before, content) in [
            (op::HEADER, 0, texts.clone()),
            (op::SCHEMA, 2, [&[1, 0][..], &texts, &[0; 4]].concat()),
            (op::CHANNEL, 4, [&[1, 0, 2, 0][..], &texts, &[0; 4]].concat()),
            (op::CHUNK, 28, [&[0; 28][..], &texts[..9], &[0; 8]].concat()),
            (op::CHUNK_INDEX, 54, index),
            (op::ATTACHMENT, 16, [&[0; 16][..], &texts, &[0; 12]].concat()),
            (op::ATTACHMENT_INDEX, 40, [&[0; 40][..], &texts].concat()),
            (op::METADATA, 0, [&texts[..9], &[0; 4]].concat()),
            (op::METADATA_INDEX, 16, [&[0; 16][..], &texts[..9]].concat()),
        ] {
            assert!(texts_fit(kind, &content), "{kind:#04x}");
            refused_without_room(kind, &content, before);
        }
    }

    /// Refuses a record with a wrong length of the text at `at`, without allocating for it.
    fn refused_without_room(kind: u8, content: &[u8], at: usize) {
        let mut false_one = content.to_vec();
        false_one[at + 3] = 0x7f;
        let allocated = allocation_counter::measure(|| assert!(parse(kind, &false_one).is_err()));
        assert!(allocated.bytes_max < 1_000, "{kind:#04x} {at}: {} bytes", allocated.bytes_max);
    }
}
