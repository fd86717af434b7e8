//! Draws matches: the reference frame and a frame side by side, with lines between matching keypoints.
//!
//! In: two frames and their matches. Out: a drawing in which inliers and outliers of the robust estimator have
//! different colours. Cost: some 120 bytes per match.

use super::layout::{Entry, Mark, Page, TEXT};
use super::photograph::Photograph;
use crate::align::diagnostics::Matching;
use crate::draw::svg::{Anchor, Area, Colour, Drawing, Path, Pen};

const INLIER: Colour = Colour(86, 196, 255);
const OUTLIER: Colour = Colour(255, 122, 46);

/// Largest number of lines that are drawn. More lines would hide each other.
const MOST_LINES: usize = 160;
/// Distance between the two frames, in pixels.
const GAP: f64 = 16.0;
/// Height of the line of text above each frame, which names it, in pixels.
const NAMES: f64 = 26.0;

/// Returns the smallest n for which one line for every n-th match gives at most [`MOST_LINES`] lines.
fn stride(matches: usize) -> usize {
    matches.div_ceil(MOST_LINES).max(1)
}

/// Draws `matching`: the reference frame on the left, a frame on the right. Each is given as its name and its
/// photograph.
pub(in crate::inspect) fn draw(
    title: &str,
    [reference, frame]: [(&str, &Photograph); 2],
    matching: &Matching,
) -> Result<Drawing, String> {
    let inliers = matching.inliers();
    let entry = |colour, words: String| Entry { mark: Mark::Line, colour, words };
    let legend = [
        entry(INLIER, format!("inliers: {inliers}")),
        entry(OUTLIER, format!("outliers: {}", matching.pairs.len() - inliers)),
    ];
    let mut notes =
        "A match is a pair of keypoints that are more similar to each other than to other keypoints of the same kind and of \
                     similar size and direction. Inliers agree with the homography, outliers do not."
            .to_owned();
    let stride = stride(matching.pairs.len());
    if stride > 1 {
        notes += &format!(" All matches are drawn as dots, one in {stride} also as a line.");
    }
    if reference.1.brightened || frame.1.brightened {
        notes += " Dark frames are shown brightened.";
    }
    let (left, right) = (reference.1.size(), frame.1.size());
    let mut page = Page::new(title, &legend, (left.0 + GAP + right.0, NAMES + left.1.max(right.1)), &notes);
    let corners = [page.corner, (page.corner.0 + left.0 + GAP, page.corner.1)].map(|(x, y)| (x, y + NAMES));
    for ((name, photograph), corner) in [reference, frame].into_iter().zip(corners) {
        page.drawing.text((corner.0, corner.1 - 8.0), TEXT, Anchor::Start, Colour::INK, name);
        photograph.put(&mut page.drawing, corner)?;
    }
    let ends: Vec<[(f64, f64); 2]> = matching
        .pairs
        .iter()
        .map(|(a, b)| [reference.1.place(corners[0], a[0], a[1]), frame.1.place(corners[1], b[0], b[1])])
        .collect();
    let all = Area { x: corners[0].0, y: corners[0].1, width: left.0 + GAP + right.0, height: left.1.max(right.1) };
    page.drawing.clipped(all, |inside| {
        // Outliers are drawn first, so that they do not hide inliers.
        for (wanted, colour) in [(false, OUTLIER), (true, INLIER)] {
            let (mut lines, mut dots) = (Path::default(), Path::default());
            for (i, [from, to]) in ends.iter().enumerate().filter(|(i, _)| matching.inlier[*i] == wanted) {
                if i % stride == 0 {
                    lines.line(*from, *to);
                }
                dots.circle(*from, 1.6);
                dots.circle(*to, 1.6);
            }
            inside.stroke(&lines, Pen { colour: Colour::INK, width: 2.2, opacity: 0.3 });
            inside.stroke(&lines, Pen { colour, width: 1.0, opacity: 0.8 });
            inside.fill(&dots, colour, 0.9);
        }
    });
    Ok(page.drawing)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::Transform;
    use crate::plane::Plane;

    #[test]
    fn lines_are_few_and_dots_are_all() {
        assert_eq!([0, 1, 160, 161, 1600].map(stride), [1, 1, 1, 2, 10]);
        let grey = Plane::filled(320, 200, 128u8);
        let photograph = Photograph::new(&grey, (800, 800));
        let pairs: Vec<_> =
            (0..321).map(|i| ([f64::from(i % 300), f64::from(i / 3)], [f64::from(i % 290), 50.0])).collect();
        let inlier = (0..321).map(|i| i % 2 == 0).collect();
        let matching = Matching { pairs, inlier, transform: Some(Transform::Identity) };
        let svg = draw("t", [("a", &photograph), ("b", &photograph)], &matching).unwrap().to_svg();
        // In the SVG, a circle consists of two arcs (`a`), and a line has one `L`. Each match has two circles, and
        // every third match has a line.
        let count =
            |pen, letter| svg.lines().filter(|l| l.contains(pen)).map(|p| p.matches(letter).count()).sum::<usize>();
        assert_eq!(count("fill-opacity=\"0.9\"", "a1.6 1.6"), 2 * 2 * 321);
        assert_eq!(count("stroke-opacity=\"0.8\"", "L"), 107);
        assert!(
            svg.contains("inliers: 161") && svg.contains("outliers: 160") && svg.contains("one in 3 also as a line")
        );
    }
}
