//! The tracked poses to an avatar program, while they move.

use handcast_hand::{ClipHand, Morphology, Side, TimedPose};
use handcast_vmc::VmcError;

use crate::cli::common::Hand;
use crate::cli::receivers::Receivers;

/// What goes to an avatar.
#[derive(Clone, Debug, clap::Args)]
pub struct AvatarArgs {
    /// Send the poses to an avatar program, too, by the VMC protocol; the port is 39539 where none is given. Several times: to
    /// several
    #[arg(long, value_name = "HOST:PORT")]
    vmc: Vec<String>,
    /// To the avatar send this hand alone
    #[arg(long, value_enum, value_name = "HAND", requires = "vmc")]
    only: Option<Hand>,
    /// To the avatar leave out the rotation of the hand itself, for receivers that place hands themselves
    #[arg(long, requires = "vmc")]
    fingers: bool,
}

impl AvatarArgs {
    /// The way to the avatar, where one is asked for.
    pub fn connect(&self) -> anyhow::Result<Option<Avatar>> {
        if self.vmc.is_empty() {
            return Ok(None);
        }
        let receivers = Receivers::connect(&self.vmc, !self.fingers).map_err(|error| match error {
            VmcError::Target { .. } => anyhow::Error::from(error).context("--vmc"),
            error => anyhow::Error::from(error)
                .context("--vmc: there is no way to the avatar program, so that no room is opened"),
        })?;
        Ok(Some(Avatar { receivers, only: self.only.map(Side::from), sizes: [None, None] }))
    }
}

/// Programs that show an avatar.
#[derive(Debug)]
pub struct Avatar {
    receivers: Receivers,
    only: Option<Side>,
    sizes: [Option<Morphology>; 2],
}

impl Avatar {
    /// Sends the poses of an instant; where there are none, the avatar stays as it is. What goes wrong is said, and the room
    /// goes on.
    pub fn send(&mut self, time: f64, poses: &[TimedPose], hands: &[ClipHand]) {
        for hand in hands {
            let known = &mut self.sizes[hand.side as usize];
            if let Some(sizes) = &hand.morphology
                && known.as_ref() != Some(sizes)
            {
                self.receivers.set_sizes(hand.side, sizes);
                *known = Some(sizes.clone());
            }
        }
        let wanted = |pose: &&TimedPose| self.only.is_none_or(|side| pose.pose.side == side);
        let poses: Vec<TimedPose> = poses.iter().filter(wanted).cloned().collect();
        if !poses.is_empty() {
            self.receivers.send(time, time, &poses);
        }
    }

    /// Says that no hand is tracked any more, and on standard error what was sent.
    pub fn end(mut self, time: f64, quiet: bool) -> Result<(), VmcError> {
        let ended = self.receivers.end(time);
        for (address, sent) in self.receivers.sent().filter(|_| !quiet) {
            errln!("{} poses in {} packets to {address}", sent.poses, sent.packets);
        }
        self.receivers.tell_unheard();
        ended
    }
}
