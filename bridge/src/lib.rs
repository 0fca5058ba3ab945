//! msg to ROS bytes and back; the ros_tcp protocol on TCP

pub mod cdr;
pub mod command;
pub mod frame;
pub mod ros;
