//! The one command-line tool of Vergence.

fn main() {}
