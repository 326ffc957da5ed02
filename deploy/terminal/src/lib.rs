//! Terminal output of the command `goalward`: short numbers, remarks and lines that update themselves for people, exit
//! codes for scripts.

pub mod numbers;
pub mod print;
pub mod refusal;
pub mod status_line;
pub mod voice;
