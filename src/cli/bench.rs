//! `handcast bench`: measurements.

mod codec;
mod fit;

/// Measure parts of the program
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, clap::Subcommand)]
enum What {
    Codec(codec::Args),
    Fit(fit::Args),
}

/// Runs the measurement asked for.
pub fn run(args: &Args) -> anyhow::Result<()> {
    match &args.what {
        What::Codec(args) => codec::run(args),
        What::Fit(args) => fit::run(args),
    }
}
