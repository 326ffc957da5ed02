//! Formats numbers for people: every result is short, and no function can fail.
//!
//! A number that is not known yet (not finite) is written as a dash.

use std::fmt::Write;

/// Stands for an unknown number.
const UNKNOWN: &str = "-";

/// Formats `1500000` as `1,500,000`.
pub fn count(number: u64) -> String {
    let digits = number.to_string();
    let mut text = String::with_capacity(digits.len() * 4 / 3);
    for (position, digit) in digits.chars().enumerate() {
        if position > 0 && (digits.len() - position).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

/// Formats a share with `decimals` decimals: `0.974` as `97 %` or `97.4 %`.
pub fn percent(share: f64, decimals: usize) -> String {
    known(share, |share| format!("{:.decimals$} %", share * 100.0))
}

/// Returns `part` of `whole` in whole percent, at most 100, rounded down: 100 means finished.
pub fn percent_done(part: u64, whole: u64) -> u64 {
    let percents = u128::from(part) * 100 / u128::from(whole.max(1));
    percents.min(100) as u64
}

/// Formats steps per second as a whole number.
pub fn rate(per_second: f64) -> String {
    known(per_second, |per_second| format!("{} steps/s", count(per_second.max(0.0) as u64)))
}

/// Formats seconds in the two units that matter: `52 s`, `3 min 20 s`, `1 h 02 min`.
pub fn duration(seconds: f64) -> String {
    known(seconds, |seconds| {
        let seconds = seconds.max(0.0).round() as u64;
        match seconds {
            0..60 => format!("{seconds} s"),
            60..3600 => format!("{} min {:02} s", seconds / 60, seconds % 60),
            _ => format!("{} h {:02} min", count(seconds / 3600), seconds % 3600 / 60),
        }
    })
}

/// Formats bytes in the unit that suits: `812 B`, `3.4 KiB`, `117.0 MiB`.
pub fn bytes(bytes: u64) -> String {
    let mut amount = bytes as f64;
    let mut unit = "B";
    for larger in ["KiB", "MiB", "GiB", "TiB"] {
        if amount < 1024.0 {
            break;
        }
        (amount, unit) = (amount / 1024.0, larger);
    }
    let decimals = usize::from(unit != "B");
    format!("{amount:.decimals$} {unit}")
}

/// Formats a loss or a mean, with about three significant digits.
pub fn number(number: f64) -> String {
    known(number, |number| match number.abs() {
        0.0 => "0".to_owned(),
        size if !(1e-4..1e4).contains(&size) => format!("{number:.1e}"),
        size if size < 0.1 => format!("{number:.4}"),
        size if size < 10.0 => format!("{number:.3}"),
        _ => format!("{number:.1}"),
    })
}

/// Formats names and values in two columns, one row per line.
pub fn table(rows: &[(&str, String)]) -> String {
    let width = rows.iter().map(|(name, _)| name.chars().count()).max().unwrap_or(0);
    rows.iter().fold(String::new(), |mut text, (name, value)| {
        writeln!(text, "  {name:width$}  {value}").expect("a text takes what is written to it");
        text
    })
}

/// Formats texts in columns, one row per line; the first row holds the titles.
pub fn columns<const N: usize>(rows: &[[String; N]]) -> String {
    let width = |column: usize| rows.iter().map(|row| row[column].chars().count()).max();
    let widths: [usize; N] = std::array::from_fn(|column| width(column).unwrap_or(0));
    rows.iter().fold(String::new(), |mut text, row| {
        let padded = row.iter().zip(widths).map(|(entry, width)| format!("{entry:width$}"));
        let line = padded.collect::<Vec<_>>().join("  ");
        writeln!(text, "  {}", line.trim_end()).expect("a text takes what is written to it");
        text
    })
}

fn known(number: f64, write: impl FnOnce(f64) -> String) -> String {
    if number.is_finite() { write(number) } else { UNKNOWN.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thousands_are_separated() {
        let written = [0, 7, 999, 1000, 12_345, 1_500_000, u64::MAX].map(count);
        let expected =
            ["0", "7", "999", "1,000", "12,345", "1,500,000", "18,446,744,073,709,551,615"];
        assert_eq!(written, expected);
    }

    #[test]
    fn shares_and_rates() {
        assert_eq!(percent(0.974, 0), "97 %");
        assert_eq!(percent(0.974, 1), "97.4 %");
        assert_eq!(percent(f64::NAN, 0), "-");
        assert_eq!(percent_done(0, 0), 0);
        assert_eq!(percent_done(1_499_999, 1_500_000), 99);
        assert_eq!(percent_done(u64::MAX, 1), 100);
        assert_eq!(rate(5123.9), "5,123 steps/s");
        assert_eq!(rate(f64::INFINITY), "-");
    }

    #[test]
    fn durations_have_two_units_at_most() {
        assert_eq!(duration(0.2), "0 s");
        assert_eq!(duration(59.6), "1 min 00 s");
        assert_eq!(duration(200.0), "3 min 20 s");
        assert_eq!(duration(3725.0), "1 h 02 min");
        assert_eq!(duration(f64::NAN), "-");
    }

    #[test]
    fn sizes_and_numbers() {
        assert_eq!(bytes(812), "812 B");
        assert_eq!(bytes(3500), "3.4 KiB");
        assert_eq!(bytes(117 << 20), "117.0 MiB");
        assert_eq!(number(0.0), "0");
        assert_eq!(number(0.01234), "0.0123");
        assert_eq!(number(1.5), "1.500");
        assert_eq!(number(-2.5e-7), "-2.5e-7");
        assert_eq!(number(14.25), "14.2");
        assert_eq!(number(f64::NAN), "-");
    }

    #[test]
    fn tables_are_aligned() {
        let rows = [("a", "1".to_owned()), ("longer", "2".to_owned())];
        assert_eq!(table(&rows), "  a       1\n  longer  2\n");
        let rows = [["a", "b", "c"], ["1", "22", ""], ["", "2", "3"]];
        let rows = rows.map(|row| row.map(str::to_owned));
        assert_eq!(columns(&rows), "  a  b   c\n  1  22\n     2   3\n");
    }
}
