//! Default names of results.
//!
//! In: the names of the inputs. Out: names beside them. Cost: negligible.

use std::cmp::Ordering;
use std::path::{Path, PathBuf};

/// Returns the output files of a run for which the user names none. Inputs are sorted by name. The output files are
/// beside the first input, and named after the first and the last, such as `IMG_0001-IMG_0003.exr` and `.png`.
pub fn default_outputs(images: &[PathBuf]) -> Vec<PathBuf> {
    named_after(images, &["exr", "png"])
}

/// Returns the folder of an inspection if the user names none: as in [`default_outputs`], with the extension
/// `.inspect`.
pub fn default_folder(images: &[PathBuf]) -> PathBuf {
    named_after(images, &["inspect"]).pop().unwrap_or_default()
}

/// Sorts `images` by name. Returns a path for each of `extensions`: beside the first image, and named after the first
/// and the last image.
fn named_after(images: &[PathBuf], extensions: &[&str]) -> Vec<PathBuf> {
    let mut sorted: Vec<&PathBuf> = images.iter().collect();
    sorted.sort_by(|a, b| natural(a, b));
    let (Some(first), Some(last)) = (sorted.first(), sorted.last()) else {
        return Vec::new();
    };
    let stem = |p: &Path| p.file_stem().unwrap_or_default().to_os_string();
    extensions
        .iter()
        .map(|extension| {
            let mut name = stem(first);
            name.push("-");
            name.push(stem(last));
            name.push(".");
            name.push(extension);
            first.with_file_name(name)
        })
        .collect()
}

/// Compares names in natural order: numbers in the names are compared as numbers, so that 9 comes before 10.
pub fn natural(a: &Path, b: &Path) -> Ordering {
    let text = |p: &Path| p.to_string_lossy().into_owned();
    let (left, right) = (text(a), text(b));
    let (mut l, mut r) = (left.as_str(), right.as_str());
    loop {
        let digits = |s: &str| s.len() - s.trim_start_matches(|c: char| c.is_ascii_digit()).len();
        let (dl, dr) = (digits(l), digits(r));
        if dl > 0 && dr > 0 {
            let number = |s: &str| s.trim_start_matches('0').to_owned();
            let (nl, nr) = (number(&l[..dl]), number(&r[..dr]));
            let order = nl.len().cmp(&nr.len()).then(nl.cmp(&nr));
            if order != Ordering::Equal {
                return order;
            }
            (l, r) = (&l[dl..], &r[dr..]);
            continue;
        }
        let (mut cl, mut cr) = (l.chars(), r.chars());
        match (cl.next(), cr.next()) {
            (Some(x), Some(y)) if x == y => (l, r) = (cl.as_str(), cr.as_str()),
            (x, y) => return x.cmp(&y).then_with(|| a.cmp(b)),
        }
    }
}

/// Returns the name of a tone-mapped picture if the user gives none: beside the radiance map `input`, with the
/// extension `.png`.
pub fn default_picture(input: &Path) -> PathBuf {
    input.with_extension("png")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn outputs_are_named_after_the_first_and_the_last_by_number() {
        let paths = |names: &[&str]| names.iter().map(PathBuf::from).collect::<Vec<_>>();
        assert_eq!(default_outputs(&paths(&["d/10.jpg", "d/9.jpg", "d/11.jpg"])), paths(&["d/9-11.exr", "d/9-11.png"]));
        let expected = paths(&["IMG_0001-IMG_0003.exr", "IMG_0001-IMG_0003.png"]);
        assert_eq!(default_outputs(&paths(&["IMG_0003.JPG", "IMG_0001.JPG", "IMG_0002.JPG"])), expected);
        assert_eq!(default_folder(&paths(&["d/10.jpg", "d/9.jpg"])), PathBuf::from("d/9-10.inspect"));
        assert!(default_outputs(&[]).is_empty());
    }

    #[test]
    fn natural_order_is_an_order() {
        let sorted = ["a", "a1", "a01", "a2", "a10", "a10b", "b"];
        for (i, a) in sorted.iter().enumerate() {
            for (j, b) in sorted.iter().enumerate() {
                let order = natural(Path::new(a), Path::new(b));
                if [*a, *b] == ["a1", "a01"] || [*a, *b] == ["a01", "a1"] {
                    assert_ne!(order, Ordering::Equal);
                } else {
                    assert_eq!(order, i.cmp(&j), "{a} {b}");
                }
            }
        }
    }

    #[test]
    fn a_picture_is_named_after_its_radiance() {
        assert_eq!(default_picture(Path::new("d/room.v2.exr")), PathBuf::from("d/room.v2.png"));
    }
}
