//! The tracked poses to an avatar program, while they move.

use handcast_hand::{ClipHand, Morphology, Side, TimedPose};
use handcast_vmc::{VmcError, VmcSender};

use crate::cli::common::Hand;
use crate::cli::listening::Listening;

/// What goes to an avatar.
#[derive(Clone, Debug, clap::Args)]
pub struct AvatarArgs {
    /// Send the poses to an avatar program, too, by the VMC protocol; the port is 39539 where none is given
    #[arg(long, value_name = "HOST:PORT")]
    vmc: Option<String>,
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
        let Some(target) = &self.vmc else { return Ok(None) };
        let sender = VmcSender::connect(target).map_err(|error| match error {
            VmcError::Target { .. } => anyhow::Error::from(error).context("--vmc"),
            error => anyhow::Error::from(error)
                .context("--vmc: there is no way to the avatar program, so that no room is opened"),
        })?;
        let sender = sender.with_wrist(!self.fingers);
        let listening = Listening::default();
        Ok(Some(Avatar { sender, listening, only: self.only.map(Side::from), sizes: [None, None] }))
    }
}

/// A program that shows an avatar.
#[derive(Debug)]
pub struct Avatar {
    sender: VmcSender,
    listening: Listening,
    only: Option<Side>,
    sizes: [Option<Morphology>; 2],
}

impl Avatar {
    /// Sends the poses of an instant; where there are none, the avatar stays as it is.
    pub fn send(&mut self, time: f64, poses: &[TimedPose], hands: &[ClipHand]) -> Result<(), VmcError> {
        for hand in hands {
            let known = &mut self.sizes[hand.side as usize];
            if let Some(sizes) = &hand.morphology
                && known.as_ref() != Some(sizes)
            {
                self.sender.set_sizes(hand.side, sizes);
                *known = Some(sizes.clone());
            }
        }
        let wanted = |pose: &&TimedPose| self.only.is_none_or(|side| pose.pose.side == side);
        let poses: Vec<TimedPose> = poses.iter().filter(wanted).cloned().collect();
        if poses.is_empty() {
            return Ok(());
        }
        self.sender.send(time, &poses)?;
        self.listening.look(time, self.sender.sent(), self.sender.address());
        Ok(())
    }

    /// Says that no hand is tracked any more, and on standard error what was sent.
    pub fn end(mut self, time: f64, quiet: bool) -> Result<(), VmcError> {
        self.sender.end(time)?;
        let (sent, address) = (self.sender.sent(), self.sender.address());
        if !quiet {
            errln!("{} poses in {} packets to {address}", sent.poses, sent.packets);
        }
        if sent.unheard > 0 {
            errln!("handcast: nothing listened at {address} for {} packets", sent.unheard);
        }
        Ok(())
    }
}
