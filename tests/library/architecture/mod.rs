//! Rules of the architecture: layers, independent alternatives, portable arithmetic, a silent library, short files.
//! Checked in the sources.

pub mod source;

use source::{Source, sources};
use std::collections::{BTreeMap, BTreeSet};

/// The layers: a module uses only modules of its own layer and of those before it in this list.
const LAYERS: [&str; 26] = [
    "error",
    "limits",
    "intake",
    "tiff_file",
    "simd",
    "plane",
    "statistics",
    "scratch",
    "budget",
    "pyramid",
    "pixel",
    "bracket",
    "align",
    "response",
    "merge",
    "tonemap",
    "write",
    "read",
    "report",
    "draw",
    "inspect",
    "compare",
    "page",
    "pipeline",
    "batch",
    "cli",
];

/// Alternatives for the same task, which must not use each other.
const ALTERNATIVES: [(&str, &[&str]); 6] = [
    ("align", &["bitmaps", "features"]),
    ("align::features", &["sift", "surf"]),
    ("align::features::robust", &["ransac", "lmeds"]),
    ("response", &["debevec", "mitsunaga_nayar", "robertson"]),
    ("tonemap", &["natural", "operators"]),
    ("tonemap::operators", &["reinhard", "drago", "durand", "fattal", "mantiuk06", "mantiuk08"]),
];

/// Largest number of lines of a file.
const MOST_LINES: usize = 500;

/// Functions of the platform's mathematical library, whose results depend on the platform. sqrt, abs, floor, ceil and
/// round are exact.
const PLATFORM: [&str; 28] = [
    "ln", "ln_1p", "log", "log2", "log10", "exp", "exp2", "exp_m1", "powf", "powi", "sin", "cos", "tan", "sin_cos",
    "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh", "cbrt", "hypot", "mul_add",
    "gamma",
];

fn is_program(source: &Source) -> bool {
    source.path == "src/main.rs" || source.module.first().is_some_and(|m| m == "cli")
}

/// Returns whether `source` is a module that is compiled only for tests, in a separate file.
fn is_test(source: &Source) -> bool {
    source.module.iter().any(|m| m == "tests" || m == "scene")
}

fn code() -> impl Iterator<Item = Source> {
    sources().into_iter().filter(|s| !is_test(s))
}

fn assert_none(offenders: Vec<String>, rule: &str) {
    assert!(offenders.is_empty(), "{rule}:\n  {}\n", offenders.join("\n  "));
}

fn against_layers(source: &Source) -> Vec<String> {
    let level = |name: &str| LAYERS.iter().position(|l| *l == name);
    // The crate's root only lists the modules; main uses only the command line.
    let own = match source.module.first() {
        Some(name) => match level(name) {
            Some(own) => own,
            None => return vec![format!("{}:1: `{name}` is in no layer", source.path)],
        },
        None => return Vec::new(),
    };
    let mut found = Vec::new();
    for (path, at) in source.paths() {
        let Some(used) = path.first().and_then(|name| level(name)) else {
            found.push(format!("{}: `crate::{}` is in no layer", source.place(at), path.join("::")));
            continue;
        };
        if used > own || is_program(source) && used != own {
            found.push(format!("{}: {} uses `{}`", source.place(at), LAYERS[own], path.join("::")));
        }
    }
    if !is_program(source) {
        found.extend(source.words("hdralign::").map(|at| format!("{}: the library by its own name", source.place(at))));
    }
    found
}

#[test]
fn every_file_uses_only_the_layers_before_its_own() {
    let sources: Vec<Source> = code().collect();
    let uses: usize = sources.iter().map(|s| s.paths().len()).sum();
    assert!(uses > 100, "only {uses} paths found in all sources: the check is blind");
    assert_none(sources.iter().flat_map(against_layers).collect(), "against the layers");
}

#[test]
fn documented_layers_are_the_layers() {
    let text = include_str!("../../../src/lib.rs");
    let (_, list) = text.split_once("A module uses only those before it:").expect("the list");
    let (list, _) = list.split_once("the program's").expect("its end");
    let named: Vec<&str> = list.split('`').skip(1).step_by(2).map(|name| name.trim_start_matches("mod@")).collect();
    assert_eq!(named, LAYERS[..LAYERS.len() - 1], "src/lib.rs");
}

/// For each module with children: each pair of children of which the first uses the second, and the first place of such
/// a use.
type Edges = BTreeMap<String, BTreeMap<(String, String), String>>;

fn sibling_edges(sources: &[Source]) -> Edges {
    let modules: BTreeSet<&[String]> = sources.iter().map(|s| s.module.as_slice()).collect();
    let mut edges = Edges::new();
    for source in sources {
        for (path, at) in source.paths() {
            let common = source.module.iter().zip(&path).take_while(|(a, b)| a == b).count();
            if common == 0 || common == source.module.len() || common == path.len() {
                continue;
            }
            // A path that names no module names an item of the parent.
            if modules.contains(&path[..=common]) {
                let edge = (source.module[common].clone(), path[common].clone());
                let siblings = edges.entry(path[..common].join("::")).or_default();
                siblings.entry(edge).or_insert_with(|| source.place(at));
            }
        }
    }
    edges
}

/// Returns the siblings that `from` uses, directly or through others, each with the chain of uses that was found first.
fn reach(edges: &BTreeMap<(String, String), String>, from: &str) -> BTreeMap<String, Vec<String>> {
    let mut ways: BTreeMap<String, Vec<String>> = BTreeMap::new();
    let mut open = vec![vec![from.to_owned()]];
    while let Some(way) = open.pop() {
        for (_, to) in edges.keys().filter(|(a, _)| Some(a) == way.last()) {
            if !ways.contains_key(to) {
                let further: Vec<String> = way.iter().chain([to]).cloned().collect();
                ways.insert(to.clone(), further.clone());
                open.push(further);
            }
        }
    }
    ways
}

fn cycles(edges: &Edges) -> Vec<String> {
    let mut found = Vec::new();
    let mut seen = BTreeSet::new();
    for (parent, siblings) in edges {
        for (from, _) in siblings.keys() {
            if let Some(way) = reach(siblings, from).get(from) {
                let members: BTreeSet<String> = way.iter().cloned().collect();
                if seen.insert((parent, members)) {
                    found.push(format!("{parent}: {}", way.join(" -> ")));
                }
            }
        }
    }
    found
}

#[test]
fn siblings_do_not_use_each_other_in_circles() {
    let sources: Vec<Source> = code().collect();
    let edges = sibling_edges(&sources);
    let places = |cycle: &String| {
        let parent = cycle.split(':').next().and_then(|_| cycle.split(": ").next()).unwrap_or_default();
        let inside =
            edges[parent].iter().filter(|((a, b), _)| cycle.contains(a.as_str()) && cycle.contains(b.as_str()));
        format!("{cycle} ({})", inside.map(|(_, at)| at.as_str()).collect::<Vec<_>>().join(", "))
    };
    assert_none(cycles(&edges).into_iter().map(|c| places(&c)).collect(), "in a circle");
}

fn rivals_that_meet(edges: &Edges) -> Vec<String> {
    let mut found = Vec::new();
    for (stage, rivals) in ALTERNATIVES {
        let Some(siblings) = edges.get(stage) else { continue };
        for from in rivals {
            let met = reach(siblings, from);
            found.extend(rivals.iter().filter(|r| *r != from).filter_map(|r| met.get(*r)).map(|way| {
                let first = &siblings[&(way[0].clone(), way[1].clone())];
                format!("{first}: {stage}: {}", way.join(" -> "))
            }));
        }
    }
    found
}

#[test]
fn alternatives_do_not_use_each_other() {
    assert_none(rivals_that_meet(&sibling_edges(&code().collect::<Vec<_>>())), "rivals that know each other");
}

fn platform_calls(source: &Source) -> Vec<String> {
    let mut found = Vec::new();
    for name in PLATFORM {
        for form in [format!(".{name}("), format!("f32::{name}"), format!("f64::{name}")] {
            // A method call ends with `(`; a path must not continue with a longer name.
            let whole =
                |at: usize| !source.code[at + form.len()..].starts_with(|c: char| c.is_alphanumeric() || c == '_');
            let at = source.code.match_indices(&form).map(|(at, _)| at).filter(|&at| form.ends_with('(') || whole(at));
            found.extend(at.map(|at| format!("{}: `{form}`: take it from libm", source.place(at))));
        }
    }
    found
}

#[test]
fn arithmetic_on_the_data_path_is_the_same_on_every_platform() {
    let found = code().filter(|s| !is_program(s)).flat_map(|s| platform_calls(&s)).collect();
    assert_none(found, "the platform's own mathematics");
}

fn noises(source: &Source) -> Vec<String> {
    let forbidden = [
        "println!",
        "print!",
        "eprintln!",
        "eprint!",
        "dbg!",
        "process::exit",
        "std::env",
        "env::args",
        "env::var",
        "env::vars",
        "env::current_dir",
        "stdout()",
        "stderr()",
        "stdin()",
    ];
    let found = forbidden.iter().flat_map(|f| source.words(f).map(move |at| (f, at)));
    found.map(|(f, at)| format!("{}: `{f}`", source.place(at))).collect()
}

#[test]
fn the_library_never_prints_exits_or_looks_around() {
    let found = code().filter(|s| !is_program(s)).flat_map(|s| noises(&s)).collect();
    assert_none(found, "only the program speaks to the outside");
}

#[test]
fn only_the_program_knows_clap_and_the_progress_bar() {
    let uses = |s: &Source| {
        ["clap", "indicatif"]
            .iter()
            .flat_map(|n| s.words(n).map(|at| s.place(at)).collect::<Vec<_>>())
            .collect::<Vec<_>>()
    };
    let outside = code().filter(|s| !is_program(s)).flat_map(|s| uses(&s)).collect();
    assert_none(outside, "the command line outside of cli/");
}

#[test]
fn no_file_is_long() {
    let long = sources().into_iter().filter(|s| s.lines > MOST_LINES);
    assert_none(long.map(|s| format!("{}:{}: too long, split it", s.path, s.lines)).collect(), "files of many lines");
}

#[test]
fn no_module_has_a_vague_name() {
    let names = ["utils", "util", "common", "helpers", "misc", "core", "types"];
    let vague = sources().into_iter().filter(|s| s.module.iter().any(|m| names.contains(&m.as_str())));
    assert_none(vague.map(|s| format!("{}:1", s.path)).collect(), "modules that could hold anything");
}

/// Crates that by default compute sums in another order, or with fused operations, on another CPU.
const OF_THE_PROCESSOR: [&str; 3] = ["matrixmultiply", "gemm", "blas-src"];

#[test]
fn no_crate_has_the_processor_choose_the_order_of_sums() {
    let lock = include_str!("../../../Cargo.lock");
    assert!(lock.contains("name = \"nalgebra\""), "the check is blind");
    let found = OF_THE_PROCESSOR.iter().filter(|name| lock.contains(&format!("name = \"{name}\"")));
    assert_none(found.map(|name| format!("Cargo.lock: {name}")).collect(), "bytes would differ between processors");
}

#[test]
fn there_is_no_unsafe_code() {
    let found: Vec<String> =
        sources().iter().flat_map(|s| s.words("unsafe").map(|at| s.place(at)).collect::<Vec<_>>()).collect();
    assert_none(found, "unsafe");
    let manifest = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/Cargo.toml")).expect("Cargo.toml");
    assert!(manifest.contains("unsafe_code = \"forbid\""), "Cargo.toml no longer forbids unsafe code");
}

/// Tests of the checks, with made-up sources that violate the rules.
mod made_up {
    use super::*;

    #[test]
    fn layers_are_seen_in_trees_in_paths_and_through_super() {
        let text = "use crate::{error::Error, merge::{self, weight as w}, plane::*};\n\
                    // crate::write::nothing\nfn f(_: &str) { super::tonemap::x(); \"crate::cli\"; crate::align::g() }\n\
                    #[cfg(test)]\nmod tests { use crate::write::y; }\nfn g() { crate::report::z() }\n";
        let found = against_layers(&Source::new("src/align/mod.rs", text));
        let at = |line| format!("src/align/mod.rs:{line}: align uses ");
        let expected = [at(1) + "`merge`", at(1) + "`merge::weight`", at(6) + "`report::z`", at(3) + "`tonemap::x`"];
        assert_eq!(found, expected);
        assert_eq!(against_layers(&Source::new("src/attic.rs", "")), ["src/attic.rs:1: `attic` is in no layer"]);
        assert_eq!(against_layers(&Source::new("src/cli/merge.rs", "use crate::plane::Plane;")).len(), 1);
        assert!(against_layers(&Source::new("src/cli/merge.rs", "use super::input; use hdralign::plane;")).is_empty());
    }

    #[test]
    fn cycles_and_uses_between_alternatives_are_found() {
        let sources = [
            Source::new("src/response/mod.rs", "mod debevec;"),
            Source::new("src/response/debevec.rs", "use super::{Curve, solve};"),
            Source::new("src/response/solve.rs", "use super::robertson::step;"),
            Source::new("src/response/robertson.rs", "use crate::response::solve::{self, one};"),
        ];
        let edges = sibling_edges(&sources);
        assert_eq!(cycles(&edges), ["response: robertson -> solve -> robertson"]);
        let met = ["src/response/debevec.rs:1: response: debevec -> solve -> robertson"];
        assert_eq!(rivals_that_meet(&edges), met);
    }

    #[test]
    fn calls_are_seen_and_comments_and_texts_are_not() {
        let text = "/// x.ln()\nfn f(x: f32) -> f32 {\n let c = '\"'; x.powi(2) + r#\"x.exp()\"#.len() }\nfn g() { a.map(f64::sin); unlogged.print(); }\n";
        let source = Source::new("src/plane.rs", text);
        let expected = ["src/plane.rs:3: `.powi(`: take it from libm", "src/plane.rs:4: `f64::sin`: take it from libm"];
        assert_eq!(platform_calls(&source), expected);
        assert!(noises(&source).is_empty());
        let loud = Source::new(
            "src/plane.rs",
            "fn f() { println!(\"x\"); std::env::var(\"X\"); let unsafety = env!(\"A\"); }",
        );
        let expected = ["src/plane.rs:1: `println!`", "src/plane.rs:1: `std::env`", "src/plane.rs:1: `env::var`"];
        assert_eq!(noises(&loud), expected);
        assert_eq!(loud.words("unsafe").count(), 0);
        assert_eq!(Source::new("src/x.rs", "unsafe { }").words("unsafe").count(), 1);
    }
}
