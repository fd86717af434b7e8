//! The report page: self-contained, correct, and safe for any file names.
//!
//! `cargo test --test cli page -- --ignored` opens the page in Chromium (or the program in `HDRALIGN_CHROMIUM`), with
//! `tests/page_in_chromium.py`.

use crate::support::{FRAMES, Folder, jpeg, small, small_jpeg, window};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use image::{GrayImage, Rgb, RgbImage};
use std::process::Command;

/// Largest size of a page with five frames, in bytes.
const MOST_BYTES: usize = 3_000_000;

fn page(folder: &Folder, line: &str) -> String {
    folder.line(&format!("{line} --report page.html --force")).done();
    String::from_utf8(folder.bytes("page.html")).expect("UTF-8")
}

/// Returns the tags in the body of the page up to the script, without the angle brackets.
fn tags(html: &str) -> Vec<&str> {
    let body = html.split_once("<body>").expect("a body").1.split_once("<script>").expect("a script").0;
    body.split('<').skip(1).map(|t| t.split_once('>').expect("an end of the tag").0).collect()
}

/// Returns the values of the attribute `name` of the tags that have it.
fn attributes<'a>(tags: &[&'a str], name: &str) -> Vec<&'a str> {
    let start = format!(" {name}=\"");
    tags.iter().filter_map(|t| Some(t.split_once(start.as_str())?.1.split('"').next().unwrap_or_default())).collect()
}

/// Returns the picture in the first `src="data:...` after `mark`.
fn picture(html: &str, mark: &str) -> RgbImage {
    let from = html.split_once(mark).unwrap_or_else(|| panic!("{mark}")).1;
    let data = from.split_once("src=\"data:image/jpeg;base64,").expect("a picture").1;
    let bytes = STANDARD.decode(data.split('"').next().expect("an end")).expect("base64");
    // Not decoded by `image`, which is wrong for chroma at half the resolution in some sizes.
    let mut decoder = jpeg_decoder::Decoder::new(&bytes[..]);
    let pixels = decoder.decode().expect("a picture");
    let size = decoder.info().expect("a size");
    RgbImage::from_raw(size.width.into(), size.height.into(), pixels).expect("three channels")
}

/// Returns the picture of frame `name` in its card on the page.
fn card(html: &str, name: &str) -> GrayImage {
    image::DynamicImage::from(picture(html, &format!("data-caption=\"{name}"))).to_luma8()
}

/// Returns the correlation, -1..=1, of the edges of `a` with those of `b` moved by (dx, dy) pixels; both have the same
/// size.
fn agreement(a: &GrayImage, b: &GrayImage, (dx, dy): (i64, i64)) -> f64 {
    assert_eq!(a.dimensions(), b.dimensions());
    let (w, h) = (i64::from(a.width()), i64::from(a.height()));
    let slope = |of: &GrayImage, x: i64, y: i64| {
        let at = |x: i64| f64::from(of.get_pixel(x as u32, y as u32)[0]);
        // The logarithm makes exposures comparable.
        (at(x + 1) + 1.0).ln() - (at(x - 1) + 1.0).ln()
    };
    let (mut both, mut one, mut two) = (0.0, 0.0, 0.0);
    for y in 12..h - 12 {
        for x in 12..w - 12 {
            let (p, q) = (slope(a, x, y), slope(b, x + dx, y + dy));
            (both, one, two) = (both + p * q, one + p * p, two + q * q);
        }
    }
    both / (one * two).sqrt()
}

/// Returns the page without the parts that depend on the speed of the machine.
fn without_times(html: &str) -> String {
    let is_time = |line: &&str| line.contains("class=\"bar\"") || line.contains("<dt>Time</dt>");
    html.lines().filter(|line| !is_time(line)).collect::<Vec<_>>().join("\n")
}

/// Checks that the page loads nothing from elsewhere and has no event handlers.
fn assert_whole(html: &str) {
    let tags = tags(html);
    let loaded: Vec<&str> = ["src", "href", "srcset", "data", "action", "poster", "xlink:href"]
        .iter()
        .flat_map(|name| attributes(&tags, name))
        .filter(|address| !address.starts_with('#'))
        .collect();
    assert!(loaded.len() > 3 && loaded.iter().all(|a| a.starts_with("data:image/")), "{loaded:.60?}");
    for word in ["http:", "https:", "@import", "url("] {
        assert!(!html.contains(word), "{word}");
    }
    assert!(html.contains("default-src 'none'; img-src data:;"));
    assert!(tags.iter().all(|t| !t.starts_with("script") && !t.starts_with("link") && !t.starts_with("iframe")));
    // The tags without quoted values, so that only names of attributes are left: none is an event handler.
    let bare: Vec<String> = tags.iter().map(|t| t.split('"').step_by(2).collect()).collect();
    let words = bare.iter().flat_map(|t| t.split_whitespace().skip(1));
    let names: Vec<&str> = words.filter(|a| a.starts_with("on")).collect();
    assert!(names.is_empty(), "{names:?}");
}

#[test]
fn page_of_a_merge_is_complete_and_self_contained() {
    let folder = Folder::empty();
    let mut arguments = vec!["merge".into()];
    arguments.extend((1..=FRAMES).map(window));
    arguments.extend(["-o", "a.exr", "--deghost", "--report", "page.html"].map(Into::into));
    folder.run(arguments).done();
    let html = String::from_utf8(folder.bytes("page.html")).expect("UTF-8");
    assert!(html.len() < MOST_BYTES, "{} bytes", html.len());
    assert_eq!(folder.listing().iter().map(|(name, _)| name.as_str()).collect::<Vec<_>>(), ["a.exr", "page.html"]);
    assert_whole(&html);
    for i in 1..=FRAMES {
        assert!(html.contains(&format!("<h3>window_{i}.jpg</h3>")), "{i}");
    }
    // The result has all its pixels, and so have the frames.
    let crop = picture(&html, "class=\"canvas\"");
    assert_eq!(crop.width(), image::image_dimensions(window(1)).map(|size| size.0).expect("a size").min(crop.width()));
    assert_eq!(html.matches(&format!("width=\"{}\" height=\"{}\" alt=", crop.width(), crop.height())).count(), 6);
    assert!(html.contains("This page contains the result at full size") && !html.contains("look softer"));
    // The choices are: pictures (the result and every frame) and zooms (fit, 100 % and 200 %).
    assert_eq!((html.matches("name=\"shown\"").count(), html.matches("name=\"zoom\"").count()), (1 + FRAMES, 3));
    // Nothing moved: there is no overlay to switch on.
    assert!(!html.contains("type=\"checkbox\"") && html.contains("Nothing moved in the scene."));
    // Four frames moved; each has a slider and plots over rotation and both shifts.
    assert_eq!((html.matches("type=\"range\"").count(), html.matches("rotation, degrees</text>").count()), (4, 4));
    for section in ["frames", "settings", "details"] {
        assert!(html.contains(&format!("<section id=\"{section}\"")), "{section}");
    }
    for part in ["alignment", "bitmaps", "movement", "light", "shares", "run"] {
        assert!(html.contains(&format!("<details class=\"part\" id=\"{part}\">")), "{part}");
    }
    assert!(tags(&html).iter().all(|tag| !(tag.starts_with("details") && tag.contains(" open"))), "open details");
    for words in [
        "No warnings",
        "All 5 frames were merged. Their exposures are 8.0 stops apart.",
        "The camera moved by up to",
        "window_4.jpg</b>, the reference",
        "<code>--crop none</code> keeps it",
        "a.exr",
        "Removal of movement, strength <code>--deghost</code>",
        "sRGB curve",
        "1/512\u{a0}s",
        "Tone-map",
    ] {
        assert!(html.contains(words), "{words}");
    }
    let tags = tags(&html);
    let (images, words) = (tags.iter().filter(|t| t.starts_with("img ")).count(), attributes(&tags, "alt"));
    assert!(images > 15 && words.len() == images && words.iter().all(|w| !w.is_empty()), "{images} {words:?}");
}

#[test]
fn frames_on_the_page_are_aligned_with_the_result() {
    let folder = Folder::with_bracket();
    let html = page(&folder, "merge w2.jpg w3.jpg w4.jpg --reference w4.jpg -o a.png");
    let result = image::DynamicImage::from(picture(&html, "class=\"canvas\"")).to_luma8();
    let file = image::open(folder.at("a.png")).expect("a picture").to_luma8();
    assert!(result.dimensions() == file.dimensions() && agreement(&result, &file, (0, 0)) > 0.9);
    for name in ["w2.jpg", "w3.jpg", "w4.jpg"] {
        let frame = card(&html, name);
        let here = agreement(&result, &frame, (0, 0));
        let beside = [(2, 0), (-2, 0), (0, 2), (0, -2)].map(|by| agreement(&result, &frame, by));
        assert!(beside.iter().all(|other| here > other + 0.1), "{name}: {here} {beside:?}");
    }
}

#[test]
fn large_picture_is_reduced_with_a_note() {
    let folder = Folder::empty();
    for (i, stops) in [-1.0, 1.0].iter().enumerate() {
        // The noise makes the JPEG large.
        let photograph = RgbImage::from_fn(2400, 1600, |x, y| {
            let grain = f64::from(((x * 7919) ^ (y * 104_729)).wrapping_mul(0x9E37_79B9) >> 26) - 32.0;
            let v = 110.0 + 50.0 * (f64::from(x) / 70.0).sin() + 40.0 * (f64::from(y) / 50.0).cos() + grain;
            Rgb([(v * f64::exp2(0.5 * stops)).clamp(0.0, 255.0) as u8; 3])
        });
        folder.put(&format!("p{i}.jpg"), &jpeg(&photograph, Some(3 + i)));
    }
    let html = page(&folder, "merge p0.jpg p1.jpg --align none --crop none -o r.jpg");
    assert!(html.len() < MOST_BYTES, "{} bytes", html.len());
    let result = picture(&html, "class=\"canvas\"");
    let share = 100.0 * f64::from(result.width()) / 2400.0;
    let pixels = result.width() * result.height();
    assert!((2_900_000..=3_000_000).contains(&pixels), "{pixels}");
    let words = format!(
        "the result is reduced here to {} × {} pixels. Its full size is 2400 × 1600 pixels. <b>A zoom of 100\u{a0}% \
         shows it at {share:.0}\u{a0}% of its full size.</b> Open <code>r.jpg</code>",
        result.width(),
        result.height()
    );
    assert!(html.contains(&words), "{words}");
    let frame = card(&html, "p0.jpg");
    let words = format!("The frames are shown at {} × {} pixels, so they look softer.", frame.width(), frame.height());
    assert!(frame.width() < result.width() && html.contains(&words), "{words}");
}

#[test]
fn movement_is_laid_over_the_picture() {
    let folder = Folder::with_bracket();
    let mut painted = small(4);
    for (x, y) in (130..170).flat_map(|x| (80..120).map(move |y| (x, y))) {
        painted.put_pixel(x, y, Rgb([if (x + y) / 8 % 2 == 0 { 40 } else { 60 }; 3]));
    }
    folder.put("w4.jpg", &jpeg(&painted, Some(4)));
    let html = page(&folder, "merge w2.jpg w3.jpg w4.jpg --reference w3.jpg --crop none -o a.exr");
    assert_whole(&html);
    assert!(html.contains("Something moved in") && html.contains("the picture shows what <b>w3.jpg</b> shows"));
    assert!(html.contains("type=\"checkbox\" name=\"movement\"") && html.contains(">Go to: <button"));
    let from = html.split_once("class=\"over movement\"").expect("an overlay").1.split_once("base64,").expect("data").1;
    let bytes = STANDARD.decode(from.split('"').next().expect("an end")).expect("base64");
    let overlay = image::load_from_memory(&bytes).expect("a picture").to_rgba8();
    // The overlay is coloured over the square, and transparent in a corner.
    assert_eq!(overlay.dimensions(), (300, 200));
    assert!(overlay.get_pixel(150, 100)[3] > 100 && overlay.get_pixel(3, 3)[3] == 0);
    let off = page(&folder, "merge w2.jpg w3.jpg w4.jpg --reference w3.jpg --deghost=off -o a.exr");
    assert!(!off.contains("type=\"checkbox\"") && off.contains("Movement was not looked for"));
}

#[test]
fn align_writes_a_page_or_json_by_extension() {
    let folder = Folder::with_bracket();
    let html = page(&folder, "align w2.jpg w3.jpg w4.jpg");
    assert_whole(&html);
    assert!(html.contains("type=\"range\"") && !html.contains("id=\"shares\"") && !html.contains("id=\"light\""));
    // The viewer has the frames, and no result.
    assert!(html.contains("All 3 frames were aligned.") && !html.contains("value=\"result\""));
    assert_eq!(html.matches("name=\"shown\"").count(), 3);
    folder.line("align w2.jpg w3.jpg w4.jpg --report R.JSON").done();
    assert!(folder.bytes("R.JSON").starts_with(b"{"));
    let refused = folder.line("merge w2.jpg w3.jpg -o a.exr --report page.pdf");
    assert_eq!(refused.code, 2);
    for words in ["page.pdf", ".json", ".html"] {
        assert!(refused.stderr.contains(words), "{}", refused.stderr);
    }
    assert!(!folder.at("a.exr").exists());
}

#[test]
fn page_is_the_same_except_for_times() {
    let folder = Folder::with_bracket();
    let line = "merge w1.jpg w2.jpg w3.jpg w4.jpg w5.jpg -o a.exr";
    let first = page(&folder, &format!("{line} --threads 1"));
    // The smallest memory limit, with which the frames are on disk.
    let second = page(&folder, &format!("{line} --threads 16 --max-memory 64MB"));
    assert_eq!(without_times(&first), without_times(&second));
    let results = folder.bytes("a.exr");
    folder.line(&format!("{line} --force")).done();
    assert!(results == folder.bytes("a.exr"), "a page changes no result");
}

#[test]
fn names_are_escaped_and_warnings_are_shown() {
    let folder = Folder::empty();
    let hostile =
        ["<img src=x onerror=alert(1)>.jpg", "\"><script>alert(2)<\u{2044}script>.jpg", "'&amp; onload='x.jpg"];
    for (i, name) in hostile.iter().enumerate() {
        folder.put(name, small_jpeg(i + 2));
    }
    // A frame of another scene, which is rejected with a warning.
    let stripes = image::RgbImage::from_fn(300, 200, |x, y| image::Rgb([(x * 7 % 256) as u8, (y * 3 % 256) as u8, 40]));
    folder.put("stripes.jpg", &crate::support::jpeg(&stripes, Some(5)));
    let arguments = ["merge", "-o", "a.exr", "--report", "page.html", "stripes.jpg"].iter().chain(&hostile);
    let run = folder.run(arguments);
    assert_eq!(run.code, 0, "{}", run.stderr);
    let html = String::from_utf8(folder.bytes("page.html")).expect("UTF-8");
    assert_whole(&html);
    for name in [
        "&lt;img src=x onerror=alert(1)&gt;.jpg",
        "&quot;&gt;&lt;script&gt;alert(2)",
        "&#39;&amp;amp; onload=&#39;x.jpg",
    ] {
        assert!(html.contains(name), "{name}");
    }
    assert!(!html.contains("<img src=x") && html.matches("<script").count() == 1);
    // The page has the same warnings as stderr.
    let said: Vec<&str> = run.stderr.lines().filter_map(|l| l.strip_prefix("warning: ")).collect();
    let left_out = said.iter().find(|w| w.contains("stripes.jpg")).unwrap_or_else(|| panic!("{}", run.stderr));
    // The page shows what was found, and the remedy.
    let (what, remedy) = left_out.split_once(": ").and_then(|(_, text)| text.rsplit_once("; ")).expect("a remedy");
    assert!(html.contains(&format!("<b>Have a look: stripes.jpg.</b> {}", what.replacen('r', "R", 1))), "{what}");
    let remedy = remedy.replacen("if", "If", 1).replace("--unmoved", "<code>--unmoved</code>");
    let plain = remedy.split(", or").next().expect("its beginning");
    assert!(html.contains(&format!("<span class=\"remedy\">{plain}")), "{plain}");
    assert!(html.contains("of 4 frames were merged.") && html.contains("<b>stripes.jpg</b> could not be aligned"));
}

#[test]
#[ignore = "needs Chromium, or HDRALIGN_CHROMIUM to name it"]
fn page_in_chromium_loads_nothing_and_its_slider_works() {
    let program = match std::env::var("HDRALIGN_CHROMIUM") {
        Ok(path) if path != "1" => path,
        _ => "chromium".to_owned(),
    };
    let folder = Folder::with_bracket();
    page(&folder, "merge w1.jpg w2.jpg w3.jpg w4.jpg w5.jpg -o a.exr");
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/page_in_chromium.py");
    let run =
        Command::new("python3").args([script, "--chromium", &program, "page.html"]).current_dir(folder.path()).output();
    let run = run.expect("python3 starts");
    let said = String::from_utf8_lossy(&run.stdout);
    assert!(run.status.success() && said.contains("sliders work"), "{said}{}", String::from_utf8_lossy(&run.stderr));
}
