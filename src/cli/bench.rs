//! `handcast bench`: measurements on recorded motion.

mod baselines;
mod codec;
mod curve;

/// Measure parts of the program on recorded motion
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, clap::Subcommand)]
enum What {
    Codec(codec::Args),
}

/// Runs the measurement asked for.
pub fn run(args: &Args) -> anyhow::Result<()> {
    match &args.what {
        What::Codec(args) => codec::run(args),
    }
}
