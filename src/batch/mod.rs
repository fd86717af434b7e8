//! Batches: brackets are found in folders, planned as jobs, and processed on one machine or by a workflow engine.
//!
//! In: folders of photographs. Out: a plan, the results of its jobs, and a summary. Cost: reading the header of every
//! photograph, and that of the jobs.
//!
//! [`find`](find::find) finds brackets and [`plan`](plan::plan) turns them into jobs. [`job::run`] runs one job,
//! completely or not at all, and only if its results are missing or out of date; [`schedule::run`] runs all on this
//! machine. [`summary::Summary`] reports the results.

mod estimate;
pub mod find;
pub mod job;
pub mod name;
pub mod plan;
pub mod record;
pub mod schedule;
pub mod summary;

/// The program and its version.
pub const SOFTWARE: &str = concat!("hdralign ", env!("CARGO_PKG_VERSION"));
