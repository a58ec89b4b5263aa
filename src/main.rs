//! The `volition` command.

fn main() {}
