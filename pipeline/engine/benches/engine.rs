//! How fast the engine is where it could be in the way: hashing, and a run in which everything is cached.
fn main() {}
