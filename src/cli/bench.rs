//! `handcast bench`: measurements.

mod baselines;
mod choices;
mod codec;
mod corpus;
mod curve;
mod fit;
mod gaps;
mod labels;
mod live;
mod sizes;
mod track;
mod tuning;

/// Measures parts of the program
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, clap::Subcommand)]
enum What {
    Choices(choices::Args),
    Codec(codec::Args),
    Corpus(Box<corpus::Args>),
    Fit(fit::Args),
    Gaps(gaps::Args),
    Labels(labels::Args),
    Live(live::Args),
    Sizes(sizes::Args),
    Track(Box<track::Args>),
    Tuning(tuning::Args),
}

/// Runs the measurement asked for.
pub fn run(args: &Args) -> anyhow::Result<()> {
    match &args.what {
        What::Choices(args) => choices::run(args),
        What::Codec(args) => codec::run(args),
        What::Corpus(args) => corpus::run(args),
        What::Fit(args) => fit::run(args),
        What::Gaps(args) => gaps::run(args),
        What::Labels(args) => labels::run(args),
        What::Live(args) => live::run(args),
        What::Sizes(args) => sizes::run(args),
        What::Track(args) => track::run(args),
        What::Tuning(args) => tuning::run(args),
    }
}
