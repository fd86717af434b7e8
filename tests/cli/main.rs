//! The program: exit codes, streams, files, reports, golden files, failures of the machine.

#[path = "../support/mod.rs"]
mod support;

mod adjust;
mod bad_brackets;
mod batch;
mod book;
mod cards;
mod child;
mod colours;
mod compare;
mod documents;
mod faults;
mod ghosts;
mod golden;
mod inspect;
mod kills;
mod limits;
mod memory;
mod names;
mod numbers;
mod page;
mod phones;
mod pictures;
mod places;
mod raw;
mod refusals;
mod report;
mod response;
mod shell;
mod streams;
mod tonemap;
mod ultra_hdr;
mod units;
