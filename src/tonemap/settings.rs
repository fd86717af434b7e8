//! Settings of the tone mapping operators, accessed by name: for the command line, the manual and programs.
//!
//! In: a name and a number. Out: validated options.

use crate::error::{Error, Result};

/// The variable that holds a setting.
#[doc(hidden)]
#[derive(Debug)]
pub enum Place<'a> {
    /// A number.
    Number(&'a mut f64),
    /// A number, or `None` to estimate it from the picture.
    Estimated(&'a mut Option<f64>),
}

/// One setting of an operator.
#[derive(Debug)]
pub struct Setting<'a> {
    /// Name of the setting.
    pub key: &'static str,
    /// What the setting does, with its unit, on one line.
    pub about: &'static str,
    /// Smallest and largest allowed value.
    pub range: (f64, f64),
    /// The variable that holds the value of the setting.
    pub place: Place<'a>,
}

impl<'a> Setting<'a> {
    /// Returns a setting with a number in `range`.
    pub(super) fn number(key: &'static str, range: (f64, f64), value: &'a mut f64, about: &'static str) -> Self {
        Setting { key, about, range, place: Place::Number(value) }
    }

    /// Returns a setting with a number in `range` that is estimated from the picture when it is not given.
    pub(super) fn estimated(
        key: &'static str,
        range: (f64, f64),
        value: &'a mut Option<f64>,
        about: &'static str,
    ) -> Self {
        Setting { key, about, range, place: Place::Estimated(value) }
    }

    /// Returns the setting for the range of the display.
    pub(super) fn range(value: &'a mut f64) -> Self {
        Setting::number("range", (3.0, 12.0), value, "stops from black to white on the display")
    }

    /// Returns the setting for the target of the mean code value.
    pub(super) fn brightness(value: &'a mut f64) -> Self {
        let about = "target for the mean pixel value, 0 to 1; it is not always reached";
        Setting::number("brightness", (0.1, 0.9), value, about)
    }

    /// Returns the setting for saturation, which all operators have.
    pub(super) fn saturation(value: &'a mut f64) -> Self {
        Setting::number("saturation", (0.0, 3.0), value, "factor on the colourfulness of the scene; 0 is grey")
    }

    /// Checks that `value` is within the range; `operator` is the name for the message.
    fn check(&self, operator: &str, value: f64) -> Result<()> {
        let (least, most) = self.range;
        if (least..=most).contains(&value) {
            return Ok(());
        }
        let reason = format!("`{}` of `{operator}` must be from {least} to {most}, not {value}", self.key);
        Err(Error::Option { option: OPTION, reason })
    }

    /// Returns the current number; `None` when it is estimated from the picture.
    fn number_set(&self) -> Option<f64> {
        match &self.place {
            Place::Number(value) => Some(**value),
            Place::Estimated(value) => **value,
        }
    }

    /// Returns the current value as text.
    pub fn value(&self) -> String {
        self.number_set().map_or_else(|| "from the picture".into(), |value| value.to_string())
    }
}

/// The command line option that changes settings.
const OPTION: &str = "--tmo-set";

/// Checks that each of the `settings` of the operator named `operator` is within its range.
///
/// # Errors
/// [`Error::Option`] for the first setting that is out of range.
pub(super) fn validate(settings: &[Setting], operator: &str) -> Result<()> {
    settings.iter().try_for_each(|s| s.number_set().map_or(Ok(()), |value| s.check(operator, value)))
}

/// Sets the setting named `key`, one of the `settings` of the operator named `operator`, to `value`.
///
/// # Errors
/// [`Error::Option`] when there is no such setting or the value is out of range.
pub(super) fn set(settings: Vec<Setting>, operator: &str, key: &str, value: f64) -> Result<()> {
    let known = settings.iter().map(|s| s.key).collect::<Vec<_>>().join(", ");
    let Some(setting) = settings.into_iter().find(|s| s.key == key) else {
        let reason = format!("`{operator}` has no `{key}`; its settings are {known}");
        return Err(Error::Option { option: OPTION, reason });
    };
    setting.check(operator, value)?;
    match setting.place {
        Place::Number(place) => *place = value,
        Place::Estimated(place) => *place = Some(value),
    }
    Ok(())
}
