//! Tests of the library through its public functions, and of the repository as a whole: layers, licences, language,
//! test data.

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
