//! `mr-slam replay`: a recorded log through the same SLAM worker, as fast as it goes.
