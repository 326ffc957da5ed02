//! The build of Goalward that made a file. Together with configuration, seed and demonstrations it determines every
//! result.
//!
//! [`Build`] is recorded in every log, including demonstrations, in checkpoints and in summaries.
//! `protocol/words/build.rs` collects its parts.

use std::sync::OnceLock;
use std::{fmt, fs};

use serde::{Deserialize, Serialize};

use crate::digest;

/// The programs that determine results. They are in the same folder.
const PROGRAMS: [&str; 3] = ["goalward-actor", "goalward-learner", "goalward-proximity-service"];

/// A build of Goalward. The default is the unknown build, that of files which record none; it differs from every known
/// build.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Build {
    /// Version of Goalward.
    pub version: String,
    /// The newest commit that changed a file which affects results; `unknown` outside a checkout.
    pub commit: String,
    /// Whether the files may differ from the commit. Development builds always count as dirty, because they are not
    /// checked again when files change.
    pub dirty: bool,
    /// The compiler.
    pub rustc: String,
    /// Processor features that the compiler may use.
    pub target_features: String,
    /// SHA-256 of actor, learner and proximity service, which identifies a dirty build. `None` for a clean build, or
    /// if these programs are not beside the running one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub programs_sha256: Option<String>,
}

impl Build {
    /// Returns the build of the running program.
    pub fn own() -> &'static Build {
        static OWN: OnceLock<Build> = OnceLock::new();
        OWN.get_or_init(|| {
            let build = Build::compiled();
            let programs_sha256 = if build.dirty { programs_sha256() } else { None };
            Build { programs_sha256, ..build }
        })
    }

    /// Returns the build as compiled in, without the hash of the programs.
    fn compiled() -> Build {
        Build {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            commit: env!("GOALWARD_COMMIT").to_owned(),
            dirty: env!("GOALWARD_DIRTY") == "true",
            rustc: env!("GOALWARD_RUSTC").to_owned(),
            target_features: env!("GOALWARD_TARGET_FEATURES").to_owned(),
            programs_sha256: None,
        }
    }

    /// Returns whether this is the build of a file that records none.
    pub fn is_unknown(&self) -> bool {
        *self == Build::default()
    }

    /// Returns the first part that differs in `found`, with its value in `self` and in `found`; `None` if both builds
    /// give the same results.
    pub fn difference(&self, found: &Build) -> Option<(&'static str, [String; 2])> {
        if self.is_unknown() || found.is_unknown() {
            return (self != found).then(|| ("build", [self, found].map(Build::to_string)));
        }
        let changes = |build: &Build| if build.dirty { "some" } else { "none" }.to_owned();
        let programs = |build: &Build| build.programs_sha256.clone().unwrap_or("unknown".into());
        let of = |what, part: &dyn Fn(&Build) -> String| (what, [part(self), part(found)]);
        let parts = [
            of("version", &|build| build.version.clone()),
            of("commit", &|build| build.commit.clone()),
            of("changes since the commit", &changes),
            of("compiler", &|build| build.rustc.clone()),
            of("processor features", &|build| build.target_features.clone()),
            of("SHA-256 of the programs", &programs),
        ];
        parts.into_iter().find(|(_, [expected, found])| expected != found)
    }
}

/// Writes one line: version, commit, compiler.
impl fmt::Display for Build {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.is_unknown() {
            return write!(formatter, "unknown build");
        }
        let Build { version, commit, rustc, .. } = self;
        let commit = short(commit);
        write!(formatter, "{version}, commit {commit}")?;
        if self.dirty {
            write!(formatter, " and changes")?;
        }
        if let Some(programs) = &self.programs_sha256 {
            write!(formatter, " (programs {})", short(programs))?;
        }
        write!(formatter, ", {rustc}")
    }
}

/// Returns several builds as one line.
pub fn shown(builds: &[Build]) -> String {
    match builds {
        [] => Build::default().to_string(),
        builds => builds.iter().map(Build::to_string).collect::<Vec<_>>().join(", then "),
    }
}

/// Returns what `--version` prints after a program's name.
pub fn version() -> &'static str {
    static VERSION: OnceLock<String> = OnceLock::new();
    VERSION.get_or_init(|| {
        let build = Build::compiled();
        format!("{build}, processor features {}", build.target_features)
    })
}

/// Returns the first 12 characters of a hash.
pub fn short(hash: &str) -> &str {
    hash.get(..12).unwrap_or(hash)
}

fn programs_sha256() -> Option<String> {
    let own = std::env::current_exe().ok()?;
    let programs: Option<Vec<_>> =
        PROGRAMS.iter().map(|name| fs::read(own.with_file_name(name)).ok()).collect();
    Some(digest::sha256(programs?))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn build() -> Build {
        Build {
            version: "0.1.0".to_owned(),
            commit: "0123456789abcdef".to_owned(),
            rustc: "rustc 1.95.0".to_owned(),
            target_features: "avx,fma".to_owned(),
            ..Build::default()
        }
    }

    #[test]
    fn what_differs_is_named() {
        let known = build();
        assert_eq!(known.difference(&known), None);
        assert_eq!(Build::default().difference(&Build::default()), None);
        let commit = Build { commit: "f00".to_owned(), ..build() };
        let (what, [expected, found]) = known.difference(&commit).unwrap();
        assert_eq!((what, &*expected, &*found), ("commit", "0123456789abcdef", "f00"));
        let dirty =
            |hash: &str| Build { dirty: true, programs_sha256: Some(hash.to_owned()), ..build() };
        for (one, other, expected) in [
            (known.clone(), dirty("ab"), "changes since the commit"),
            (dirty("ab"), dirty("cd"), "SHA-256 of the programs"),
            (known.clone(), Build { rustc: "rustc 1.96.0".into(), ..build() }, "compiler"),
            (
                known.clone(),
                Build { target_features: "avx".into(), ..build() },
                "processor features",
            ),
            (known, Build::default(), "build"),
        ] {
            let found = one.difference(&other).map(|(what, _)| what);
            assert_eq!(found, Some(expected));
            assert_eq!(other.difference(&one).map(|(what, _)| what), Some(expected));
        }
    }

    #[test]
    fn a_build_is_one_line() {
        assert_eq!(build().to_string(), "0.1.0, commit 0123456789ab, rustc 1.95.0");
        let dirty =
            Build { dirty: true, programs_sha256: Some("fedcba98765432".into()), ..build() };
        let expected =
            "0.1.0, commit 0123456789ab and changes (programs fedcba987654), rustc 1.95.0";
        assert_eq!(dirty.to_string(), expected);
        assert_eq!(shown(&[]), "unknown build");
        assert!(!version().contains('\n') && version().contains("rustc"), "{}", version());
    }

    #[test]
    fn a_build_survives_being_written() {
        for build in [build(), Build::own().clone()] {
            let text = serde_json::to_string(&build).unwrap();
            assert_eq!(serde_json::from_str::<Build>(&text).unwrap(), build);
        }
        assert!(!Build::own().is_unknown());
    }
}
