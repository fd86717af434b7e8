//! The time at which a photograph was taken.
//!
//! In: the text of the EXIF dates. Out: a [`Moment`], to the precision that the camera writes. Cost: negligible.
//! Source: EXIF 2.32, section 4.6.5.

use exif::{DateTime, Tag};
use std::fmt;

/// The time at which a photograph was taken, in local time of the camera clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Moment {
    seconds: i64,
    nanoseconds: u32,
    digits: u8,
}

impl Moment {
    /// Returns the number of seconds from `earlier` to this time; negative where `earlier` is the later one.
    pub fn since(&self, earlier: &Moment) -> f64 {
        (self.seconds - earlier.seconds) as f64 + (f64::from(self.nanoseconds) - f64::from(earlier.nanoseconds)) * 1e-9
    }

    /// Resolution in seconds: 1, or less where the camera wrote a fraction.
    pub fn resolution_s(&self) -> f64 {
        1.0 / f64::from(10_u32.pow(u32::from(self.digits.min(9))))
    }

    /// Parses EXIF's `YYYY:MM:DD HH:MM:SS` and the digits of the fraction.
    fn parse(date: &str, fraction: Option<&str>) -> Option<Self> {
        let mut date = DateTime::from_ascii(date.as_bytes()).ok()?;
        let digits: String = fraction.unwrap_or_default().chars().take_while(char::is_ascii_digit).take(9).collect();
        let nanoseconds = match date.parse_subsec(digits.as_bytes()) {
            Ok(()) => date.nanosecond.unwrap_or(0),
            Err(_) => 0,
        };
        let is_real = (1..=12).contains(&date.month) && (1..=31).contains(&date.day) && date.hour < 24;
        let clock = i64::from(date.hour) * 3600 + i64::from(date.minute) * 60 + i64::from(date.second);
        let seconds = days(date.year.into(), date.month.into(), date.day.into()) * 86_400 + clock;
        is_real.then_some(Moment { seconds, nanoseconds, digits: digits.len() as u8 })
    }
}

/// Returns the number of days from 1 March of the year 0 to a date of the Gregorian calendar.
fn days(year: i64, month: i64, day: i64) -> i64 {
    let (year, month) = if month > 2 { (year, month - 3) } else { (year - 1, month + 9) };
    365 * year + year.div_euclid(4) - year.div_euclid(100) + year.div_euclid(400) + (153 * month + 2) / 5 + day - 1
}

impl fmt::Display for Moment {
    /// Writes the time as EXIF does, without the fraction: `2026:11:21 17:05:59`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (year, month, day) = date(self.seconds.div_euclid(86_400));
        let clock = self.seconds.rem_euclid(86_400);
        write!(f, "{year:04}:{month:02}:{day:02} {:02}:{:02}:{:02}", clock / 3600, clock / 60 % 60, clock % 60)
    }
}

/// Returns year, month and day: the inverse of [`days`].
fn date(days: i64) -> (i64, i64, i64) {
    // The calendar repeats every 400 years, which are 146,097 days. Years begin in March here, so that a leap day is
    // the last day of its year.
    let (era, of_era) = (days.div_euclid(146_097), days.rem_euclid(146_097));
    let year_of_era = (of_era - of_era / 1460 + of_era / 36_524 - of_era / 146_096) / 365;
    let of_year = of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let month = (5 * of_year + 2) / 153;
    let day = of_year - (153 * month + 2) / 5 + 1;
    let (month, next) = if month < 10 { (month + 3, 0) } else { (month - 9, 1) };
    (era * 400 + year_of_era + next, month, day)
}

/// Returns the time of the exposure. If the file has none, returns the time of digitising, else the time of the last
/// change: a camera writes the same time to all three fields.
pub(crate) fn taken(text: &impl Fn(Tag) -> Option<String>) -> Option<Moment> {
    [
        (Tag::DateTimeOriginal, Tag::SubSecTimeOriginal),
        (Tag::DateTimeDigitized, Tag::SubSecTimeDigitized),
        (Tag::DateTime, Tag::SubSecTime),
    ]
    .into_iter()
    .find_map(|(date, fraction)| Moment::parse(&text(date).filter(|d| is_date(d))?, text(fraction).as_deref()))
}

/// Whether `text` is `YYYY:MM:DD HH:MM:SS`, and not the blanks or zeros of a clock that was never set.
pub(crate) fn is_date(text: &str) -> bool {
    let shape = b"0000:00:00 00:00:00";
    text.len() == shape.len()
        && text.bytes().zip(shape).all(|(b, &s)| if s == b'0' { b.is_ascii_digit() } else { b == s })
        && !text.starts_with("0000")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(date: &str, fraction: Option<&str>) -> Moment {
        Moment::parse(date, fraction).unwrap()
    }

    #[test]
    fn moments_are_seconds_of_the_calendar() {
        let new_year = at("2024:01:01 00:00:00", None);
        assert_eq!(at("2024:03:01 00:00:00", None).since(&new_year), 60.0 * 86_400.0);
        assert_eq!(at("2025:01:01 00:00:01", None).since(&new_year), 366.0 * 86_400.0 + 1.0);
        assert_eq!(at("2023:12:31 23:59:59", Some("75")).since(&new_year), -0.25);
        assert_eq!((new_year.resolution_s(), at("2024:01:01 00:00:00", Some("007 ")).resolution_s()), (1.0, 1e-3));
        assert!(at("2024:01:01 00:00:00", Some("5")) > new_year);
        assert_eq!(Moment::parse("2024:13:01 00:00:00", None), None);
        assert_eq!(Moment::parse("2024:01:01", None), None);
    }

    #[test]
    fn only_dates_are_dates() {
        assert!(is_date("2026:11:20 08:00:00"));
        for wrong in ["0000:00:00 00:00:00", "    :  :     :  :  ", "2026-11-20 08:00:00", "2026:11:20", ""] {
            assert!(!is_date(wrong), "{wrong}");
        }
    }
}
