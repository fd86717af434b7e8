//! Batches: finding brackets in folders, planning a job for each, and running the jobs on this machine or with a
//! workflow engine.
//!
//! In: folders of photographs. Out: a plan, the results of its jobs, and a summary. Cost: reading the header of every
//! photograph, and running the jobs.
//!
//! [`find`](find::find) finds brackets, and [`plan`](plan::plan) turns them into jobs. [`job::run`] runs one job. It
//! writes all results or none, and only if the existing results are missing or out of date. [`schedule::run`] runs
//! all jobs on this machine. [`summary::Summary`] reports the results.

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
