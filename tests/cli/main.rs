//! The contract of the program (docs: exit codes, streams, files, report), held through the binary.

#[path = "../support/mod.rs"]
mod support;

mod bad_brackets;
mod batch;
mod cards;
mod colours;
mod compare;
mod ghosts;
mod inspect;
mod limits;
mod names;
mod numbers;
mod places;
mod refusals;
mod report;
mod response;
mod shell;
mod streams;
mod tonemap;
mod ultra_hdr;
mod units;
