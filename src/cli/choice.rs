//! Arguments whose values are an enum of the library: its names are accepted, and `--help` lists them with their documentation.

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use clap::{Arg, Command};
use std::ffi::OsStr;
use strum::{EnumMessage, IntoEnumIterator};

/// Accepts one of several named values.
#[derive(Clone)]
pub struct Choice<T>(Vec<Named<T>>);

/// A value, its name and a phrase on it.
#[derive(Clone)]
struct Named<T> {
    value: T,
    name: &'static str,
    about: &'static str,
}

impl<T> Choice<T> {
    /// No value yet.
    pub fn new() -> Self {
        Choice(Vec::new())
    }

    /// With another value; `about` is the first sentence of its documentation.
    pub fn or(mut self, value: T, name: &'static str, about: &'static str) -> Self {
        self.0.push(Named { value, name, about: about.trim_end_matches('.') });
        self
    }

    fn possible(&self) -> impl Iterator<Item = PossibleValue> {
        self.0.iter().map(|named| PossibleValue::new(named.name).help(named.about))
    }
}

/// Accepts every value of `T`.
pub fn choice<T>() -> Choice<T>
where
    T: IntoEnumIterator + EnumMessage,
    for<'a> &'static str: From<&'a T>,
{
    T::iter().fold(Choice::new(), |choice, value| {
        let (name, about) = ((&value).into(), value.get_documentation().unwrap_or_default());
        choice.or(value, name, about)
    })
}

impl<T: Clone + Send + Sync + 'static> TypedValueParser for Choice<T> {
    type Value = T;

    fn parse_ref(&self, command: &Command, arg: Option<&Arg>, text: &OsStr) -> Result<T, clap::Error> {
        let name = PossibleValuesParser::new(self.possible()).parse_ref(command, arg, text)?;
        let named = self.0.iter().find(|named| named.name == name);
        named.map(|named| named.value.clone()).ok_or_else(|| clap::Error::new(clap::error::ErrorKind::InvalidValue))
    }

    fn possible_values(&self) -> Option<Box<dyn Iterator<Item = PossibleValue> + '_>> {
        Some(Box::new(self.possible()))
    }
}
