//! Batches: brackets are found in folders, planned as steps, and processed on one machine or by a workflow engine.
//!
//! In: folders of photographs. Out: a plan, the results of its steps, and a summary. Cost: reading the header of
//! every photograph, and that of the steps.
//!
//! [`find`](find::find) finds brackets and [`plan`](plan::plan) turns them into steps. [`step::run`] runs one step,
//! completely or not at all, and only if its results are missing; [`schedule::run`] runs all on this machine.
//! [`summary::Summary`] reports the results.

mod estimate;
pub mod find;
pub mod name;
pub mod plan;
pub mod record;
pub mod schedule;
pub mod step;
pub mod summary;

/// The program and its version.
pub const SOFTWARE: &str = concat!("hdralign ", env!("CARGO_PKG_VERSION"));
