//! Response files.
