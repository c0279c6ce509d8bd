//! `handcast bench`: measurements of the codec and of registration.

mod codec;
mod track;

/// Measure the codec on recorded motion, or registration against known poses
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, clap::Subcommand)]
enum What {
    Codec(codec::Args),
    Track(track::Args),
}

/// Runs the measurement asked for.
pub fn run(args: &Args) -> anyhow::Result<()> {
    match &args.what {
        What::Codec(args) => codec::run(args),
        What::Track(args) => track::run(args),
    }
}
