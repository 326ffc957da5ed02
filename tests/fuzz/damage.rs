//! Makes fuzz inputs: slightly damaged valid inputs, or random bytes.

use proptest::prelude::*;
use proptest::sample::{Index, select};

/// Numbers that break careless arithmetic, as integers of any width.
const EXTREMES: [u64; 10] = [
    0,
    1,
    0x7f,
    0xff,
    0xffff,
    0x7fff_ffff,
    0xffff_ffff,
    0x7fff_ffff_ffff_ffff,
    0x8000_0000_0000_0000,
    0xffff_ffff_ffff_ffff,
];

/// Words that replace a number in a text.
const WORDS: [&str; 14] = [
    "0",
    "-1",
    "1",
    "4294967296",
    "9223372036854775807",
    "18446744073709551616",
    "1e999",
    "-0.0",
    "nan",
    "inf",
    "1e-320",
    "\"\"",
    "[]",
    "{}",
];

/// One change to an input.
#[derive(Clone, Debug)]
enum Damage {
    /// Flips a bit.
    Flip(Index, u32),
    /// Cuts off the end.
    Cut(Index),
    /// Overwrites 1, 2, 4 or 8 bytes with an extreme number, little-endian.
    Extreme(Index, u32, u64),
    /// Replaces a number in a text with a word.
    Word(Index, &'static str),
    /// Inserts a copy of a part elsewhere.
    Splice(Index, usize, Index),
    /// Removes a part.
    Erase(Index, usize),
    /// Inserts bytes.
    Insert(Index, Vec<u8>),
}

fn damage() -> impl Strategy<Value = Damage> {
    let at = any::<Index>;
    prop_oneof![
        3 => (at(), 0..8_u32).prop_map(|(at, bit)| Damage::Flip(at, bit)),
        1 => at().prop_map(Damage::Cut),
        3 => (at(), 0..4_u32, select(&EXTREMES[..]))
            .prop_map(|(at, width, number)| Damage::Extreme(at, width, number)),
        2 => (at(), select(&WORDS[..])).prop_map(|(at, word)| Damage::Word(at, word)),
        1 => (at(), 1..64_usize, at()).prop_map(|(from, length, to)| Damage::Splice(from, length, to)),
        1 => (at(), 1..64_usize).prop_map(|(at, length)| Damage::Erase(at, length)),
        1 => (at(), prop::collection::vec(any::<u8>(), 1..16))
            .prop_map(|(at, bytes)| Damage::Insert(at, bytes)),
    ]
}

impl Damage {
    fn apply(&self, bytes: &mut Vec<u8>) {
        let place = |at: &Index| at.index(bytes.len() + 1);
        match self {
            Damage::Flip(at, bit) => {
                let at = place(at);
                if let Some(byte) = bytes.get_mut(at) {
                    *byte ^= 1 << bit;
                }
            }
            Damage::Cut(at) => bytes.truncate(place(at)),
            Damage::Extreme(at, width, number) => {
                let number = number.to_le_bytes();
                let at = place(at);
                for (byte, new) in bytes[at..].iter_mut().zip(&number[..1 << width]) {
                    *byte = *new;
                }
            }
            Damage::Word(at, word) => replace_number(bytes, at, word),
            Damage::Splice(from, length, to) => {
                let (from, to) = (place(from), place(to));
                let part = bytes[from..].iter().copied().take(*length).collect::<Vec<_>>();
                bytes.splice(to..to, part);
            }
            Damage::Erase(at, length) => {
                let at = place(at);
                bytes.drain(at..bytes.len().min(at + length));
            }
            Damage::Insert(at, more) => {
                let at = place(at);
                bytes.splice(at..at, more.iter().copied());
            }
        }
    }
}

/// Replaces a number with a word, if the input has a number.
fn replace_number(bytes: &mut Vec<u8>, which: &Index, word: &str) {
    let is_digit = |at: usize| bytes.get(at).is_some_and(u8::is_ascii_digit);
    let begins = |at: &usize| is_digit(*at) && (*at == 0 || !is_digit(*at - 1));
    let starts: Vec<usize> = (0..bytes.len()).filter(begins).collect();
    if starts.is_empty() {
        return;
    }
    let start = *which.get(&starts);
    let end = (start..bytes.len()).find(|at| !is_digit(*at)).unwrap_or(bytes.len());
    bytes.splice(start..end, word.bytes());
}

/// Generates inputs from valid ones: nine in ten with zero to four changes, the others random bytes.
pub(crate) fn inputs(whole: Vec<Vec<u8>>) -> impl Strategy<Value = Vec<u8>> {
    let damaged =
        (select(whole), prop::collection::vec(damage(), 0..5)).prop_map(|(mut bytes, damages)| {
            damages.iter().for_each(|damage| damage.apply(&mut bytes));
            bytes
        });
    prop_oneof![9 => damaged, 1 => prop::collection::vec(any::<u8>(), 0..200)]
}
