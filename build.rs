//! Strips symbols from the release binary. The profile's `strip` does not reach a package with an override of its
//! own (`[profile.release.package.mr-slam]`): Cargo then strips debug information only.

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rerun-if-env-changed=CARGO_PROFILE_RELEASE_STRIP");
    let is_release = std::env::var("PROFILE").is_ok_and(|profile| profile == "release");
    let keeps_symbols = std::env::var("CARGO_PROFILE_RELEASE_STRIP").is_ok_and(|strip| strip == "none");
    if is_release && !keeps_symbols {
        println!("cargo::rustc-link-arg-bins=-Wl,--strip-all");
    }
}
