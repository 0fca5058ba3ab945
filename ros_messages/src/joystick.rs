//! Messages of hand controllers, as two Quest applications send them.

use crate::cdr::{DecodeError, Reader, Writer};
use crate::message::{Message, read_header};
use crate::write;
use msg::Stamp;

/// sensor_msgs/Joy: a hand controller's axes and buttons.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Joy {
    /// Time of the reading.
    pub stamp: Stamp,
    /// Frame of the device.
    pub frame_id: String,
    /// Positions of the axes, -1 to 1.
    pub axes: Vec<f32>,
    /// States of the buttons, 0 or 1.
    pub buttons: Vec<i32>,
}

impl Message for Joy {
    const TYPE: &'static str = "sensor_msgs/Joy";
    fn read(from: &mut Reader<'_>) -> Result<Self, DecodeError> {
        let (stamp, frame_id) = read_header(from)?;
        let axes = from.f32_seq("axes")?;
        let count = from.count("buttons", 4)?;
        let buttons = (0..count).map(|_| from.i32("buttons")).collect::<Result<_, _>>()?;
        Ok(Self { stamp, frame_id, axes, buttons })
    }
    fn write(&self, to: &mut Writer<'_>) {
        write::header(to, self.stamp, &self.frame_id);
        to.f32_seq(&self.axes);
        to.count(self.buttons.len());
        self.buttons.iter().for_each(|button| to.i32(*button));
    }
}

/// quest2ros/OVR2ROSInputs: the controller of one hand.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct HandInputs {
    /// Button B or Y.
    pub button_upper: bool,
    /// Button A or X.
    pub button_lower: bool,
    /// Deflection from -1 (left) to 1 (right).
    pub thumb_stick_horizontal: f32,
    /// Deflection from -1 (towards the hand) to 1 (away from it).
    pub thumb_stick_vertical: f32,
    /// Pressure of the trigger, 0 to 1.
    pub press_index: f32,
    /// Pressure of the grip, 0 to 1.
    pub press_middle: f32,
}

impl Message for HandInputs {
    const TYPE: &'static str = "quest2ros/OVR2ROSInputs";
    fn read(from: &mut Reader<'_>) -> Result<Self, DecodeError> {
        Ok(Self {
            button_upper: from.bool("button_upper")?,
            button_lower: from.bool("button_lower")?,
            thumb_stick_horizontal: from.f32("thumb_stick_horizontal")?,
            thumb_stick_vertical: from.f32("thumb_stick_vertical")?,
            press_index: from.f32("press_index")?,
            press_middle: from.f32("press_middle")?,
        })
    }
    fn write(&self, to: &mut Writer<'_>) {
        to.bool(self.button_upper);
        to.bool(self.button_lower);
        let axes =
            [self.thumb_stick_horizontal, self.thumb_stick_vertical, self.press_index, self.press_middle];
        axes.iter().for_each(|axis| to.f32(*axis));
    }
}
