//! The library, through its public functions, and what holds for the repository as a whole: layers, licences, test data.

#[path = "../support/mod.rs"]
mod support;

mod accuracy;
mod architecture;
mod language;
mod licences;
mod messages;
mod progress;
mod properties;
mod same_bytes;
mod several_brackets;
mod sift_oracle;
mod testdata;
