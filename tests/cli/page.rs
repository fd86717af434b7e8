//! The report as a page: whole in itself, true to the run, and safe whatever the files are called.
//!
//! `cargo test --test cli page -- --ignored` opens it in Chromium (`HDRALIGN_CHROMIUM` names another program), by `tests/page_in_chromium.py`.

use crate::support::{FRAMES, Folder, small_jpeg, window};
use std::process::Command;

/// A page of five frames may weigh so much, in bytes.
const MOST_BYTES: usize = 3_000_000;

fn page(folder: &Folder, line: &str) -> String {
    folder.line(&format!("{line} --report page.html --force")).done();
    String::from_utf8(folder.bytes("page.html")).expect("UTF-8")
}

/// The tags of the page, without what is in `data:` addresses, style and script.
fn tags(html: &str) -> Vec<&str> {
    let body = html.split_once("<body>").expect("a body").1.split_once("<script>").expect("a script").0;
    body.split('<').skip(1).map(|t| t.split_once('>').expect("an end of the tag").0).collect()
}

/// What stands behind `name="` in each of the tags.
fn attributes<'a>(tags: &[&'a str], name: &str) -> Vec<&'a str> {
    let start = format!(" {name}=\"");
    tags.iter().filter_map(|t| Some(t.split_once(start.as_str())?.1.split('"').next().unwrap_or_default())).collect()
}

/// What does not depend on how quick the machine was.
fn without_times(html: &str) -> String {
    let is_time = |line: &&str| line.contains("class=\"bar\"") || line.contains("<dt>Time</dt>");
    html.lines().filter(|line| !is_time(line)).collect::<Vec<_>>().join("\n")
}

/// Nothing is loaded from anywhere.
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
    // What is left of a tag without its quoted values: no handler among the attributes.
    let bare: Vec<String> = tags.iter().map(|t| t.split('"').step_by(2).collect()).collect();
    let words = bare.iter().flat_map(|t| t.split_whitespace().skip(1));
    let names: Vec<&str> = words.filter(|a| a.starts_with("on")).collect();
    assert!(names.is_empty(), "{names:?}");
}

#[test]
fn the_page_of_a_merge_has_everything_and_needs_nothing() {
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
    // Four frames moved: each with its slider; angle and two shifts for each.
    assert_eq!((html.matches("type=\"range\"").count(), html.matches("rotation, degrees</text>").count()), (4, 4));
    for section in ["frames", "moved", "bitmaps", "light", "shares", "run"] {
        assert!(html.contains(&format!("<section id=\"{section}\"")), "{section}");
    }
    for words in [
        "No warnings",
        "stops",
        "<b>Movement.</b>",
        "a.exr",
        "deghost strength",
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
fn an_alignment_has_a_page_too_and_json_stays_json() {
    let folder = Folder::with_bracket();
    let html = page(&folder, "align w2.jpg w3.jpg w4.jpg");
    assert_whole(&html);
    assert!(html.contains("type=\"range\"") && !html.contains("id=\"shares\"") && !html.contains("id=\"light\""));
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
fn it_is_the_same_but_for_the_times() {
    let folder = Folder::with_bracket();
    let line = "merge w1.jpg w2.jpg w3.jpg w4.jpg w5.jpg -o a.exr";
    let first = page(&folder, &format!("{line} --threads 1"));
    // In as little memory as it takes, the frames on disk.
    let second = page(&folder, &format!("{line} --threads 16 --max-memory 64MB"));
    assert_eq!(without_times(&first), without_times(&second));
    let results = folder.bytes("a.exr");
    folder.line(&format!("{line} --force")).done();
    assert!(results == folder.bytes("a.exr"), "a page changes no result");
}

#[test]
fn names_stay_names_and_warnings_are_said() {
    let folder = Folder::empty();
    let hostile =
        ["<img src=x onerror=alert(1)>.jpg", "\"><script>alert(2)<\u{2044}script>.jpg", "'&amp; onload='x.jpg"];
    for (i, name) in hostile.iter().enumerate() {
        folder.put(name, small_jpeg(i + 2));
    }
    // Another scene: it is left out, with a warning.
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
    // The same warnings as on stderr.
    let said: Vec<&str> = run.stderr.lines().filter_map(|l| l.strip_prefix("warning: ")).collect();
    let left_out = said.iter().find(|w| w.contains("stripes.jpg")).unwrap_or_else(|| panic!("{}", run.stderr));
    assert!(html.contains("Have a look.") && html.contains("left out"));
    let plain = left_out.split(['\'', '"', '<', '&']).next().expect("its beginning");
    assert!(html.contains(plain), "{plain}");
}

#[test]
#[ignore = "needs Chromium, or HDRALIGN_CHROMIUM to name it"]
fn in_chromium_it_loads_nothing_and_its_slider_works() {
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
