//! An operator without a headset: attaches over ros_tcp as a headset does, and drives.
