//! Errors: stderr names the file and the remedy, the exit code is right, nothing is on stdout, and no files are
//! written.

use crate::support::{Folder, jpeg, small, small_jpeg};
use std::fs;

/// Runs `line` in `folder`, and checks that it fails with `code`, with all of `said` in the message, nothing on stdout,
/// and no file left or lost.
fn refused(folder: &Folder, line: &str, code: i32, said: &[&str]) {
    let before = folder.listing();
    let run = folder.line(line);
    assert_eq!(run.code, code, "{line}\n{}", run.stderr);
    assert_eq!(run.stdout, "", "{line}");
    assert_eq!(folder.listing(), before, "{line}: something was left behind, or lost");
    for part in said {
        assert!(run.stderr.contains(part), "{line}\n{}does not say {part:?}", run.stderr);
    }
}

#[test]
fn a_missing_file_is_named() {
    refused(
        &Folder::with_bracket(),
        "merge w1.jpg gone.jpg -o a.exr",
        1,
        &["gone.jpg", "cannot be read", "check the name"],
    );
}

#[test]
fn a_truncated_jpeg_is_named_and_to_be_copied_again() {
    let folder = Folder::with_bracket();
    let whole = small_jpeg(2);
    // The file is truncated in the middle, near the end of the picture, or in the headers.
    for length in [whole.len() / 2, whole.len() * 9 / 10, 300] {
        folder.put("cut.jpg", &whole[..length]);
        refused(&folder, "merge w1.jpg cut.jpg -o a.exr -o a.png", 1, &["cut.jpg", "JPEG", "copy the file again"]);
    }
}

#[test]
fn text_named_jpg_is_reported_as_text() {
    let folder = Folder::with_bracket();
    folder.put("notes.jpg", b"Dear diary, today I took no photograph.\n");
    refused(&folder, "merge w1.jpg notes.jpg -o a.exr", 1, &["notes.jpg", "text", "leave it out"]);
    folder.put("empty.jpg", b"");
    refused(&folder, "merge w1.jpg empty.jpg -o a.exr", 1, &["empty.jpg", "empty"]);
}

#[test]
fn one_photograph_is_an_error() {
    for command in ["merge", "align", "response", "inspect"] {
        let example = format!("hdralign {command} IMG_1.jpg");
        refused(&Folder::with_bracket(), &format!("{command} w1.jpg"), 2, &["at least two", "1 given", &example]);
    }
}

#[test]
fn reference_without_aligned_frames_is_named() {
    let folder = Folder::with_bracket();
    let mut state = 1u32;
    let strange = image::RgbImage::from_fn(small(2).width(), small(2).height(), |_, _| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        image::Rgb([(state >> 24) as u8; 3])
    });
    folder.put("strange.jpg", &jpeg(&strange, Some(2)));
    let line = "merge w3.jpg strange.jpg --reference w3.jpg -o a.exr -o a.png";
    refused(&folder, line, 1, &["w3.jpg", "no other frame was aligned", "--reference", "--align none"]);
}

#[test]
fn two_sizes_are_refused_with_both() {
    let folder = Folder::with_bracket();
    let part = image::imageops::crop_imm(&small(2), 0, 0, 280, 200).to_image();
    folder.put("narrow.jpg", &jpeg(&part, Some(2)));
    refused(
        &folder,
        "merge w1.jpg narrow.jpg -o a.exr",
        1,
        &["narrow.jpg", "280x200", "w1.jpg", "300x200", "the same size"],
    );
}

#[test]
fn one_file_twice_is_seen_by_any_name() {
    let folder = Folder::with_bracket();
    refused(&folder, "merge w1.jpg w2.jpg w1.jpg", 2, &["w1.jpg", "same file", "once"]);
    refused(&folder, "merge w1.jpg w2.jpg ./w1.jpg", 2, &["./w1.jpg", "same file"]);
    #[cfg(unix)]
    {
        std::os::unix::fs::symlink(folder.at("w1.jpg"), folder.at("link.jpg")).expect("a link");
        refused(&folder, "merge w1.jpg w2.jpg link.jpg", 2, &["link.jpg", "same file", "w1.jpg"]);
    }
}

#[test]
fn an_output_in_no_folder_is_refused_before_any_work() {
    let folder = Folder::with_bracket();
    let bad = "merge w1.jpg w2.jpg -o a.exr -o";
    refused(&folder, &format!("{bad} none/a.png"), 1, &["none/a.png", "does not exist", "mkdir -p none"]);
    refused(&folder, &format!("{bad} w3.jpg/a.png"), 1, &["w3.jpg/a.png", "not a folder"]);
    fs::create_dir(folder.at("sub.png")).expect("a folder");
    refused(&folder, &format!("{bad} sub.png"), 1, &["sub.png", "it is a folder"]);
    // There is one remedy, not two.
    let run = folder.line(&format!("{bad} none/a.png"));
    assert!(!run.stderr.contains("the free disk space"), "{}", run.stderr);
    // The error is reported before any work: that one of the photographs is missing was not noticed.
    refused(&folder, "merge w1.jpg gone.jpg -o none/a.png", 1, &["none/a.png"]);
}

#[cfg(unix)]
#[test]
fn a_folder_that_cannot_be_written_is_named() {
    use std::os::unix::fs::PermissionsExt;
    let folder = Folder::with_bracket();
    let locked = folder.at("locked");
    fs::create_dir(&locked).expect("a folder");
    fs::set_permissions(&locked, fs::Permissions::from_mode(0o555)).expect("permissions");
    // Root can write to every folder, so this test checks nothing if it is run by root.
    if fs::write(locked.join("probe"), "").is_err() {
        refused(&folder, "merge w2.jpg w3.jpg -o a.exr -o locked/a.png", 1, &["locked/a.png", "permissions"]);
        assert_eq!(fs::read_dir(&locked).expect("the folder").count(), 0);
    }
    fs::set_permissions(&locked, fs::Permissions::from_mode(0o755)).expect("permissions");
}

#[test]
fn existing_files_are_kept_unless_forced() {
    let folder = Folder::with_bracket();
    folder.put("old.png", b"precious");
    let line = "merge w2.jpg w3.jpg -o new.exr -o old.png";
    refused(&folder, line, 1, &["old.png", "exists already", "--force"]);
    assert_eq!(folder.bytes("old.png"), b"precious");
    folder.put("r.json", b"precious");
    refused(&folder, "merge w2.jpg w3.jpg -o new.exr --report r.json", 1, &["r.json", "--force"]);
    refused(&folder, "align w2.jpg w3.jpg --report r.json", 1, &["r.json", "--force"]);
    refused(&folder, "merge w2.jpg w3.jpg -o new.exr --save-response r.json", 1, &["r.json", "--force"]);
    folder.line(&format!("{line} --force")).done();
    let picture = image::load_from_memory(&folder.bytes("old.png")).expect("replaced by a picture");
    assert!(picture.width() > 200);
}

#[test]
fn unsupported_extension_lists_the_supported_ones() {
    let folder = Folder::with_bracket();
    refused(&folder, "merge w1.jpg w2.jpg -o a.bmp", 2, &["a.bmp", ".exr", ".hdr", ".tif", ".png"]);
    refused(&folder, "merge w1.jpg w2.jpg -o a.exr -o noextension", 2, &["noextension", ".exr"]);
}

#[test]
fn an_output_is_never_an_input() {
    let folder = Folder::empty();
    for i in 2..=3 {
        small(i).save(folder.at(format!("w{i}.png"))).expect("a PNG");
    }
    let before = folder.bytes("w3.png");
    for name in ["w3.png", "./w3.png"] {
        let line = format!("merge -e=-1,1 w2.png w3.png --force -o {name}");
        refused(&folder, &line, 2, &[name, "also an input file", "another name"]);
    }
    assert_eq!(folder.bytes("w3.png"), before);
    refused(&folder, "merge -e=-1,1 w2.png w3.png -o a.exr -o ./a.exr", 2, &["a.exr", "named twice"]);
}

#[test]
fn options_with_values_that_cannot_be_used_are_wrong_usage() {
    let folder = Folder::with_bracket();
    for (options, said) in [
        ("-e 1", &["-e", "1 exposures for 2 photographs", "for each photograph"][..]),
        ("-e=0,1,2", &["-e", "3 exposures for 2 photographs"]),
        ("-e=0,x", &["--ev", "'x'"]),
        ("--reference 9", &["--reference", "9", "1 to 2"]),
        ("--reference 0", &["--reference", "0", "1 to 2"]),
        ("--reference other.jpg", &["--reference", "other.jpg"]),
        ("--threads 0", &["--threads", "at least 1 thread"]),
        ("--threads many", &["--threads", "many"]),
        ("--threads 100000", &["--threads", "1024"]),
        ("-e=-1000,0", &["-e", "-1000", "-e=-2,0,2"]),
        ("--max-rotation 90", &["--max-rotation", "0..45"]),
        ("--align best", &["--align", "best", "auto"]),
        ("--crop all", &["--crop", "all", "common"]),
        ("--unknown", &["--unknown"]),
        ("--quiet --verbose", &["--quiet", "--verbose"]),
        ("--report -", &["--report", "--json"]),
    ] {
        for command in ["merge", "align"] {
            refused(&folder, &format!("{command} w2.jpg w3.jpg {options}"), 2, said);
        }
    }
    for (line, said) in [
        ("", &["Usage"][..]),
        ("melt w2.jpg w3.jpg", &["melt"]),
        ("merge", &["IMAGES"]),
        ("merge w2.jpg w3.jpg --weight heavy", &["--weight", "heavy", "hat"]),
        ("merge w2.jpg w3.jpg --response r.json --response-model srgb", &["--response"]),
        ("merge w2.jpg w3.jpg --deghost 0.25", &["0.25 was taken for a photograph", "--deghost=0.25"]),
        ("merge w2.jpg w3.jpg --response-degree 4", &["--response-degree", "mitsunaga-nayar"]),
        (
            "merge w2.jpg w3.jpg --response-model mitsunaga-nayar --response-degree 11",
            &["--response-degree", "1 to 10"],
        ),
    ] {
        refused(&folder, line, 2, said);
    }
}

/// A second `merge *.jpg` also names the results of the first one.
#[test]
fn results_are_not_used_as_photographs() {
    let folder = Folder::with_bracket();
    let frames = "w2.jpg w3.jpg w4.jpg";
    folder.line(&format!("merge {frames} -o r.jpg -o r.png -o r.tif --ghost-mask mask.png")).done();
    folder.line(&format!("align {frames} --save-aligned al_ --displacements by_")).done();
    folder.line(&format!("response {frames} -o c.json --plot c.png")).done();
    folder.line("inspect w2.jpg w3.jpg -d look").done();
    let said = "is a result of hdralign, not a photograph; leave it out";
    for name in [
        "r.jpg",
        "r.png",
        "r.tif",
        "mask.png",
        "al_w3.tif",
        "by_w2.tif",
        "c.png",
        "look/w2.threshold.png",
        "look/w2.xor.png",
    ] {
        refused(&folder, &format!("merge w1.jpg w2.jpg {name} -o a.exr"), 2, &[&format!("{name} {said}")]);
    }
    for command in ["align", "inspect -d x", "response -o x.json"] {
        refused(&folder, &format!("{command} w1.jpg w2.jpg r.jpg"), 2, &["r.jpg is a result"]);
    }
    // If `response` is given a folder, it uses only the photographs in it. Results may be compared.
    let all = folder.line("response . -o all.json --json").done();
    let json: serde_json::Value = serde_json::from_str(&all.stdout).expect("JSON");
    assert_eq!(json["brackets"][0]["frames"].as_array().map(Vec::len), Some(5));
    folder.line("compare r.png r.png").done();
}

#[test]
fn folders_are_left_to_batch() {
    let folder = Folder::with_bracket();
    for line in ["merge .", "merge . w2.jpg -o a.exr", "align ."] {
        refused(&folder, line, 1, &["it is a folder", "./*.jpg", "`hdralign batch .`"]);
    }
    for (line, said) in [
        ("batch . --by-folder -d w1.jpg", "there is a file where this path needs a folder"),
        ("batch . --by-folder -d w1.jpg/out", "there is a file where this path needs a folder"),
        ("man w1.jpg", "there is a file where this path needs a folder"),
        ("inspect w2.jpg w3.jpg -d w1.jpg", "it is a file, not a folder; give a folder with -d"),
    ] {
        refused(&folder, line, 1, &["w1.jpg", said]);
        assert!(!folder.line(line).stderr.contains("the free disk space"), "{line}");
    }
}

#[test]
fn tips_and_usage_match_the_typed_command() {
    let folder = Folder::with_bracket();
    // Before photographs, clap would suggest to pass the option as one of them.
    for line in ["merge w2.jpg w3.jpg --sharpen 50", "align --sharpen 50 w2.jpg w3.jpg"] {
        refused(&folder, line, 2, &["'--sharpen'", " [OPTIONS] <IMAGES>..."]);
        assert!(!folder.line(line).stderr.contains("tip"));
    }
    refused(&folder, "melt", 2, &["'melt'\n\nUsage: hdralign <COMMAND>\n"]);
    for (line, tip) in [
        ("merge --refrence 1", "tip: a similar argument exists: '--reference'"),
        ("merg w2.jpg", "tip: a similar subcommand exists: 'merge'"),
        ("merge w2.jpg --align sit", "tip: a similar value exists: 'sift'"),
    ] {
        refused(&folder, line, 2, &[tip]);
    }
    let line = "merge w2.jpg w3.jpg --deghost=off --ghost-mask m.png -o a.exr";
    refused(&folder, line, 2, &["--ghost-mask: there is no mask without deghosting; remove --deghost=off"]);
}

#[test]
fn transforms_of_other_photographs_are_named() {
    let folder = Folder::with_bracket();
    folder.line("align w2.jpg w3.jpg --reference w3.jpg --transforms t.json").done();
    for options in ["", "--reference w4.jpg"] {
        let line = format!("merge w4.jpg w5.jpg --transforms t.json -o a.exr {options}");
        refused(
            &folder,
            &line,
            1,
            &["t.json", "for other photographs", "its reference w3.jpg is not among those of this run"],
        );
    }
}

#[test]
fn invalid_response_file_is_named() {
    let folder = Folder::with_bracket();
    folder.put("r.json", b"{\"schema\": \"something/7\"}");
    refused(&folder, "merge w2.jpg w3.jpg -o a.exr --response r.json", 1, &["r.json", "not a usable response file"]);
    refused(&folder, "merge w2.jpg w3.jpg -o a.exr --response gone.json", 1, &["gone.json"]);
}

#[test]
fn without_exif_exposures_are_estimated_and_strict_exits_with_3() {
    let folder = Folder::empty();
    for i in 2..=4 {
        folder.put(&format!("w{i}.jpg"), &jpeg(&small(i), None));
    }
    let line = "merge w2.jpg w3.jpg w4.jpg -o a.exr";
    let run = folder.line(line).done();
    assert!(run.stderr.contains("warning: ") && run.stderr.contains("estimated from the pixels"), "{}", run.stderr);
    assert!(run.stderr.contains("-e"), "no remedy: {}", run.stderr);
    let strict = folder.line(&format!("{line} --strict --force"));
    assert_eq!((strict.code, strict.stdout.as_str()), (3, "a.exr\n"), "{}", strict.stderr);
    let given = folder.line(&format!("{line} --strict --force -e=-2,0,2"));
    assert_eq!(given.code, 0, "{}", given.stderr);
    assert!(!given.stderr.contains("estimated"), "{}", given.stderr);
}

#[test]
fn invalid_memory_limit_and_scratch_folder_are_named() {
    let folder = Folder::with_bracket();
    refused(&folder, "merge w2.jpg w3.jpg --max-memory plenty -o a.exr", 2, &["plenty", "as in `500MB`"]);
    refused(&folder, "merge w2.jpg w3.jpg --max-memory 1MB -o a.exr", 2, &["--max-memory", "at least 64 MB"]);
    let gone = "merge w2.jpg w3.jpg --threads 16 --max-memory 64MB --scratch gone -o a.exr";
    refused(&folder, gone, 1, &["gone: ", "name another folder with --scratch", "--max-memory"]);
}
