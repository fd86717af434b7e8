//! What may be set of an operator, by name: for the command line, the manual and programs.
//!
//! In: a name and a number. Out: options, validated. Cost: none.

use crate::error::{Error, Result};

/// Where a setting is kept.
#[derive(Debug)]
pub enum Place<'a> {
    /// A number.
    Number(&'a mut f64),
    /// A number, or what the picture says.
    Estimated(&'a mut Option<f64>),
}

/// One thing that may be set.
#[derive(Debug)]
pub struct Setting<'a> {
    /// Its name.
    pub key: &'static str,
    /// What it does, with its unit, on one line.
    pub about: &'static str,
    /// The least and the greatest value.
    pub range: (f64, f64),
    /// Where it is kept.
    pub place: Place<'a>,
}

impl<'a> Setting<'a> {
    /// A number in `range`.
    pub(super) fn number(key: &'static str, range: (f64, f64), value: &'a mut f64, about: &'static str) -> Self {
        Setting { key, about, range, place: Place::Number(value) }
    }

    /// A number in `range` that is estimated unless it is given.
    pub(super) fn estimated(
        key: &'static str,
        range: (f64, f64),
        value: &'a mut Option<f64>,
        about: &'static str,
    ) -> Self {
        Setting { key, about, range, place: Place::Estimated(value) }
    }

    /// The range of the display, of operators that fill it.
    pub(super) fn range(value: &'a mut f64) -> Self {
        Setting::number("range", (3.0, 12.0), value, "stops from black to white on the display")
    }

    /// The brightness that a picture is brought to.
    pub(super) fn brightness(value: &'a mut f64) -> Self {
        Setting::number("brightness", (0.1, 0.9), value, "the mean of the picture's codes, of 1")
    }

    /// The saturation, which all operators have.
    pub(super) fn saturation(value: &'a mut f64) -> Self {
        Setting::number("saturation", (0.0, 3.0), value, "times the colourfulness of the scene; 0 is grey")
    }

    /// Whether `value` is within its range; `operator` is whose it is.
    fn check(&self, operator: &str, value: f64) -> Result<()> {
        let (least, most) = self.range;
        if (least..=most).contains(&value) {
            return Ok(());
        }
        let reason = format!("`{}` of `{operator}` is from {least} to {most}, not {value}", self.key);
        Err(Error::Option { option: OPTION, reason })
    }

    /// What it is, in words.
    pub fn value(&self) -> String {
        match &self.place {
            Place::Number(value) => value.to_string(),
            Place::Estimated(Some(value)) => value.to_string(),
            Place::Estimated(None) => "from the picture".into(),
        }
    }
}

/// The option that sets them.
const OPTION: &str = "--tmo-set";

/// Checks `settings`, which are those of `operator`, against their ranges.
///
/// # Errors
/// [`Error::Option`] for the first that is out of its range.
pub(super) fn validate(settings: &[Setting], operator: &str) -> Result<()> {
    let value = |setting: &Setting| match &setting.place {
        Place::Number(value) => Some(**value),
        Place::Estimated(value) => **value,
    };
    settings.iter().filter_map(|s| Some((s, value(s)?))).try_for_each(|(s, value)| s.check(operator, value))
}

/// Sets the one of `settings`, which are those of `operator`, that is called `key`.
///
/// # Errors
/// [`Error::Option`] where there is none of that name, or the value is out of its range.
pub(super) fn set(settings: Vec<Setting>, operator: &str, key: &str, value: f64) -> Result<()> {
    let known: Vec<&str> = settings.iter().map(|s| s.key).collect();
    let known = known.join(", ");
    let Some(setting) = settings.into_iter().find(|s| s.key == key) else {
        let reason = format!("`{operator}` has no `{key}`; it has {known}");
        return Err(Error::Option { option: OPTION, reason });
    };
    setting.check(operator, value)?;
    match setting.place {
        Place::Number(place) => *place = value,
        Place::Estimated(place) => *place = Some(value),
    }
    Ok(())
}
