//! Command-line arguments whose values have names; most values are the variants of an enum of the library. The argument
//! accepts the names, and `--help` lists them with their descriptions. The description of a variant is its doc comment.

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use clap::{Arg, Command};
use std::ffi::OsStr;
use strum::{EnumMessage, IntoEnumIterator};

/// A value, its name, and a sentence that describes it.
pub type Named<T> = (T, &'static str, &'static str);

/// A parser of arguments that accepts one of several named values.
#[derive(Clone)]
pub struct Choice<T> {
    values: Vec<Named<T>>,
    /// Names that are accepted, but that `--help` does not list.
    hidden: Vec<&'static str>,
}

impl<T> FromIterator<Named<T>> for Choice<T> {
    fn from_iter<I: IntoIterator<Item = Named<T>>>(values: I) -> Self {
        Choice { values: values.into_iter().collect(), hidden: Vec::new() }
    }
}

impl<T> Choice<T> {
    /// Returns the parser with some values hidden: it still accepts the values for which `is_hidden` is true, but
    /// `--help` does not list them.
    pub fn hiding(self, is_hidden: impl Fn(&T) -> bool) -> Choice<T> {
        let hidden = self.values.iter().filter(|named| is_hidden(&named.0)).map(|named| named.1).collect();
        Choice { hidden, ..self }
    }

    fn possible(&self) -> impl Iterator<Item = PossibleValue> {
        self.values.iter().map(|(_, name, about)| {
            let about = about.split_whitespace().collect::<Vec<_>>().join(" ");
            PossibleValue::new(*name).help(about.trim_end_matches('.').to_owned()).hide(self.hidden.contains(name))
        })
    }
}

/// Returns `value` with its name and its doc comment.
pub fn named<T: EnumMessage>(value: T) -> Named<T>
where
    for<'a> &'static str: From<&'a T>,
{
    let (name, about) = ((&value).into(), value.get_documentation().unwrap_or_default());
    (value, name, about)
}

/// Returns a parser that accepts every value of `T` by its name.
pub fn choice<T>() -> Choice<T>
where
    T: IntoEnumIterator + EnumMessage,
    for<'a> &'static str: From<&'a T>,
{
    T::iter().map(named).collect()
}

impl<T: Clone + Send + Sync + 'static> TypedValueParser for Choice<T> {
    type Value = T;

    fn parse_ref(&self, command: &Command, arg: Option<&Arg>, text: &OsStr) -> Result<T, clap::Error> {
        let name = PossibleValuesParser::new(self.possible()).parse_ref(command, arg, text)?;
        let found = self.values.iter().find(|named| named.1 == name);
        found.map(|named| named.0.clone()).ok_or_else(|| clap::Error::new(clap::error::ErrorKind::InvalidValue))
    }

    fn possible_values(&self) -> Option<Box<dyn Iterator<Item = PossibleValue> + '_>> {
        Some(Box::new(self.possible()))
    }
}
