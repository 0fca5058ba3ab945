//! The one binary of MR-SLAM.
use clap::Parser;

#[derive(Parser)]
enum Command {
    Replay(mr_slam::replay::ReplayArgs),
}

fn main() {
    let Command::Replay(args) = Command::parse();
    if let Err(error) = mr_slam::replay::run(&args) {
        eprintln!("{error}");
        std::process::exit(1);
    }
}
