//! Records parsed: the texts within one are measured first, because the parser makes room for any
//! length that it reads, four gigabytes for the four bytes of a false one.

use mcap::records::{Record, op};

/// Longest record that is believed: what a damaged length can make a reader allocate.
pub(super) const LONGEST_RECORD: usize = 64 << 20;

/// What keeps a record from being taken.
pub(super) enum Trouble {
    /// It is not as it was written.
    Damage(String),
    /// It is as somebody else wrote it.
    Foreign(String),
}

/// Parses the content of a record.
///
/// # Errors
/// When it is not as the format says, or a text in it is longer than the record.
pub(super) fn parse(kind: u8, content: &[u8]) -> Result<Record<'_>, String> {
    if !texts_fit(kind, content) {
        return Err("a text in it is longer than the record".to_owned());
    }
    mcap::parse_record(kind, content).map_err(|cause| cause.to_string())
}

/// Whether the texts of a record lie within it. Kinds without texts have none that do not.
fn texts_fit(kind: u8, content: &[u8]) -> bool {
    let mut rest = Rest(content);
    let measured = match kind {
        op::METADATA => rest.text().and_then(|_| rest.map()),
        op::SCHEMA => rest.bytes(2).and_then(|_| rest.text()).and_then(|_| rest.text()),
        op::CHANNEL => {
            let texts = rest.bytes(4).and_then(|_| rest.text()).and_then(|_| rest.text());
            texts.and_then(|_| rest.map())
        }
        op::CHUNK => rest.bytes(28).and_then(|_| rest.text()),
        _ => Some(content),
    };
    measured.is_some()
}

/// What of a record is not measured yet.
struct Rest<'a>(&'a [u8]);

impl<'a> Rest<'a> {
    fn bytes(&mut self, count: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(count)?;
        self.0 = rest;
        Some(taken)
    }

    /// A length of four bytes and as many bytes.
    fn text(&mut self) -> Option<&'a [u8]> {
        let length = self.bytes(4)?.try_into().expect("four bytes were taken");
        self.bytes(u32::from_le_bytes(length) as usize)
    }

    /// A length of four bytes and, in as many bytes, pairs of texts.
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
            let mut false_one = metadata.clone();
            false_one[at + 3] = 0x7f;
            let allocated =
                allocation_counter::measure(|| assert!(parse(op::METADATA, &false_one).is_err()));
            assert!(allocated.bytes_max < 1_000, "{at}: {} bytes", allocated.bytes_max);
        }
    }
}
