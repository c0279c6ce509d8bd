//! Runs a network on given numbers and says how long one run takes: `bench_net NET RUNS [INPUT OUTPUT]`.
//!
//! INPUT and OUTPUT hold 32-bit floats, little-endian; OUTPUT gets all outputs one after the other. The time is of the
//! processor, not of the clock (on Windows of the clock). With RUNS of 0 the time of each step is shown.

use std::error::Error;
use std::time::{Duration, Instant};

use handcast_net::Network;

/// Time this thread was running, in nanoseconds.
#[cfg(unix)]
fn running() -> i64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    time.tv_sec * 1_000_000_000 + time.tv_nsec
}

/// Time by the clock, in nanoseconds, where the system tells none of a thread in a way that needs no `unsafe`.
#[cfg(not(unix))]
fn running() -> i64 {
    static START: std::sync::LazyLock<Instant> = std::sync::LazyLock::new(Instant::now);
    i64::try_from(START.elapsed().as_nanos()).unwrap_or(i64::MAX)
}

fn main() -> Result<(), Box<dyn Error>> {
    let args: Vec<String> = std::env::args().collect();
    let [_, path, runs, rest @ ..] = &args[..] else {
        return Err("bench_net NET RUNS [INPUT OUTPUT]".into());
    };
    let runs: usize = runs.parse()?;
    let start = Instant::now();
    let mut network = Network::read(&std::fs::read(path)?)?;
    eprintln!("read in {:?}, {} numbers in memory", start.elapsed(), network.memory());
    if let [input, _] = rest {
        let bytes = std::fs::read(input)?;
        let numbers = bytes.as_chunks::<4>().0.iter().map(|&b| f32::from_le_bytes(b));
        let to = network.input_mut(0).ok_or("no input")?;
        to.iter_mut().zip(numbers).for_each(|(to, x)| *to = x);
    }
    network.run()?;
    if let [_, output] = rest {
        let count = network.outputs().len();
        let all = (0..count).filter_map(|i| network.output(i)).flatten();
        std::fs::write(output, all.flat_map(|x| x.to_le_bytes()).collect::<Vec<u8>>())?;
    }
    if runs == 0 {
        let mut times: Vec<(String, Duration)> = Vec::new();
        for _ in 0..50 {
            network.profile(|i, name, time| match times.get_mut(i) {
                Some((_, best)) => *best = time.min(*best),
                None => times.push((name.to_owned(), time)),
            });
        }
        for (i, (name, time)) in times.iter().enumerate() {
            println!("{i:3} {:8.1} us  {name}", time.as_secs_f64() * 1e6);
        }
        println!("sum {:8.1} us", times.iter().map(|(_, t)| t.as_secs_f64()).sum::<f64>() * 1e6);
        return Ok(());
    }
    let mut best = i64::MAX;
    let first = running();
    for _ in 0..runs {
        let from = running();
        network.run()?;
        best = best.min(running() - from);
    }
    let mean = (running() - first) as f64 / runs as f64;
    println!("{} {}", mean / 1e6, best as f64 / 1e6);
    Ok(())
}
