//! Many brackets: found in folders, planned as steps, and done on one machine or by any engine.
//!
//! In: folders of photographs. Out: a plan, the results of its steps, and a summary. Cost: a look at the header of every photograph;
//! then that of the steps.
//!
//! [`find`](find::find) finds brackets, [`plan`](plan::plan) makes steps of them. [`step::run`] does one, whole or not at all and only where
//! it is not done; [`schedule::run`] does all on this machine. [`summary::Summary`] tells how they went.

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
