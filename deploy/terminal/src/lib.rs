//! What the command `goalward` says in a terminal: to people in short numbers, remarks and lines that
//! update themselves, to scripts in exit codes.

pub mod numbers;
pub mod print;
pub mod refusal;
pub mod status_line;
pub mod voice;
