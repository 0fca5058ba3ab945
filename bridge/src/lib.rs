//! msg to ROS bytes and back; the ros_tcp protocol on TCP
