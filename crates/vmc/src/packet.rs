//! Bones as OSC.

use rosc::{OscBundle, OscMessage, OscPacket, OscTime, OscType};

use super::{Bone, VmcError};

/// Most bytes of a packet: the 1500 that Ethernet carries in one piece, less the headers of IPv6 and UDP.
pub const MAX_PACKET: usize = 1452;

/// "At once" among OSC's instants.
const AT_ONCE: OscTime = OscTime { seconds: 0, fractional: 1 };

/// The calibration state of a sender that needs none.
const CALIBRATED: i32 = 3;

/// The bundle of one hand as bytes: `/VMC/Ext/OK` (whether a hand is `tracked`), `/VMC/Ext/T` (the sender's `time`, seconds), the
/// bones.
///
/// # Errors
/// [`VmcError::Osc`] for what OSC cannot write; no bone of [`HandBones`](super::HandBones) is such.
pub fn packet(bones: impl IntoIterator<Item = Bone>, time: f64, tracked: bool) -> Result<Vec<u8>, VmcError> {
    let tracked = i32::from(tracked);
    let ok = [tracked, CALIBRATED, 0, tracked].map(OscType::Int);
    let mut content = vec![message("/VMC/Ext/OK", ok), message("/VMC/Ext/T", [OscType::Float(time as f32)])];
    content.extend(bones.into_iter().map(|bone| {
        let numbers = bone.position.into_iter().chain(bone.rotation).map(OscType::Float);
        message("/VMC/Ext/Bone/Pos", std::iter::once(OscType::String(bone.name.into())).chain(numbers))
    }));
    let bundle = OscPacket::Bundle(OscBundle { timetag: AT_ONCE, content });
    rosc::encoder::encode(&bundle).map_err(|error| VmcError::Osc { what: format!("{error:?}") })
}

fn message(address: &str, args: impl IntoIterator<Item = OscType>) -> OscPacket {
    OscPacket::Message(OscMessage { addr: address.into(), args: args.into_iter().collect() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::HandBones;
    use handcast_hand::{HandPose, Morphology, Side};

    fn read(bytes: &[u8]) -> Vec<OscMessage> {
        let (rest, packet) = rosc::decoder::decode_udp(bytes).unwrap();
        assert!(rest.is_empty());
        let OscPacket::Bundle(bundle) = packet else { panic!("no bundle") };
        let messages = bundle.content.into_iter().map(|packet| match packet {
            OscPacket::Message(message) => message,
            OscPacket::Bundle(_) => panic!("a bundle in a bundle"),
        });
        messages.collect()
    }

    #[test]
    fn a_hand_fits_into_a_packet_and_comes_back() {
        for side in [Side::Left, Side::Right] {
            let bones: Vec<Bone> =
                HandBones::new(&Morphology::default(), side).bones(&HandPose::neutral(side)).collect();
            let bytes = packet(bones.iter().copied(), 1.5, true).unwrap();
            assert!((1300..=MAX_PACKET).contains(&bytes.len()), "{} bytes", bytes.len());
            let messages = read(&bytes);
            assert_eq!(messages.len(), 2 + crate::BONES);
            assert_eq!(messages[0].args, [1, 3, 0, 1].map(OscType::Int));
            for (message, bone) in messages[2..].iter().zip(&bones) {
                assert_eq!(message.addr, "/VMC/Ext/Bone/Pos");
                assert_eq!(message.args[0], OscType::String(bone.name.into()));
                let numbers: Vec<f32> =
                    message.args[1..].iter().map(|a| a.clone().float().unwrap()).collect();
                assert_eq!(numbers, [&bone.position[..], &bone.rotation[..]].concat());
            }
        }
    }

    #[test]
    fn no_hand_is_said() {
        let messages = read(&packet([], 2.0, false).unwrap());
        let [ok, time] = messages.as_slice() else { panic!("{messages:?}") };
        assert_eq!((ok.addr.as_str(), &ok.args[..]), ("/VMC/Ext/OK", &[0, 3, 0, 0].map(OscType::Int)[..]));
        assert_eq!((time.addr.as_str(), &time.args[..]), ("/VMC/Ext/T", &[OscType::Float(2.0)][..]));
    }
}
