//! Which topics of a bag belong to the robot of a scan topic, by their namespaces.

/// Returns what stands before the last slash of a topic's name; empty without a slash.
pub fn namespace(topic: &str) -> &str {
    topic.rsplit_once('/').map_or("", |(namespace, _)| namespace)
}

fn parts(namespace: &str) -> impl Iterator<Item = &str> {
    namespace.split('/').filter(|part| !part.is_empty())
}

/// Number of names with which both namespaces begin.
fn common(a: &str, b: &str) -> usize {
    parts(a).zip(parts(b)).take_while(|(a, b)| a == b).count()
}

/// Whether two namespaces are alike but for their numbers, as `robot1` and `robot2`.
fn differ_in_numbers(a: &str, b: &str) -> bool {
    let letters = |namespace: &str| namespace.replace(|c: char| c.is_ascii_digit(), "");
    a != b && letters(a) == letters(b)
}

/// Returns those of the topics that are of the robot with the scans: in the scans' namespace, else in the one that has most in
/// common with it. A topic that has more in common with other scans is another robot's. Several namespaces that are equally
/// near are none. Where there is one topic with scans and one of the others, they are one robot's, whatever their namespaces
/// are called, as `/front_laser` and `/wheels`; but for namespaces that differ in their numbers.
pub fn of_same_robot<'a>(scan_topic: &str, scan_topics: &[&str], topics: &[&'a str]) -> Vec<&'a str> {
    let of_scans = namespace(scan_topic);
    if let ([_], [only]) = (scan_topics, topics)
        && !differ_in_numbers(of_scans, namespace(only))
    {
        return vec![*only];
    }
    let is_own = |topic: &str| {
        let (own, others) = (common(namespace(topic), of_scans), scan_topics.iter());
        let is_anothers = others.into_iter().any(|other| common(namespace(topic), namespace(other)) > own);
        // Two namespaces without a name in common may be two robots.
        let is_apart =
            own == 0 && parts(of_scans).next().is_some() && parts(namespace(topic)).next().is_some();
        !is_anothers && !is_apart
    };
    let nearness = |topic: &str| {
        let names = parts(namespace(topic)).count();
        let own = common(namespace(topic), of_scans);
        // Of equally near ones the one that lies above the scans.
        (own, own == names)
    };
    let own: Vec<&str> = topics.iter().copied().filter(|topic| is_own(topic)).collect();
    let Some(best) = own.iter().map(|topic| nearness(topic)).max() else { return Vec::new() };
    let nearest: Vec<&str> = own.into_iter().filter(|topic| nearness(topic) == best).collect();
    let is_one = nearest.iter().all(|topic| namespace(topic) == namespace(nearest[0]));
    if is_one { nearest } else { Vec::new() }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found<'a>(scan_topic: &str, others: &[&str], topics: &[&'a str]) -> Vec<&'a str> {
        of_same_robot(scan_topic, &[&[scan_topic], others].concat(), topics)
    }

    #[test]
    fn the_nearest_namespace_is_the_robots() {
        let topics = ["/odom", "/robot1/odom", "/robot2/odom"];
        let of = |scan| found(scan, &[], &topics);
        assert_eq!(of("/robot1/scan"), ["/robot1/odom"]);
        assert_eq!(of("/robot2/front/scan"), ["/robot2/odom"]);
        assert_eq!(of("/scan"), ["/odom"]);
        assert_eq!(of("/robot3/scan"), ["/odom"]);
        assert_eq!(found("/scan", &[], &["/wheels/odom"]), ["/wheels/odom"]);
        assert_eq!(found("/a/laser/scan", &[], &["/a/wheels/odom"]), ["/a/wheels/odom"]);
        assert_eq!(found("/front_laser/scan", &[], &["/wheels/odometry"]), ["/wheels/odometry"]);
        assert!(found("/front_laser/scan", &["/rear_laser/scan"], &["/wheels/odometry"]).is_empty());
    }

    #[test]
    fn another_robots_topics_are_not_taken() {
        assert!(found("/robot1/scan", &["/robot2/scan"], &["/robot2/odom"]).is_empty());
        assert!(found("/robot1/scan", &[], &["/robot2/odom"]).is_empty());
        assert!(found("/scan", &["/robot2/scan"], &["/robot2/odom"]).is_empty());
        assert!(found("/fleet/a/scan", &["/fleet/b/scan"], &["/fleet/b/odom"]).is_empty());
        // Two that are equally near: nobody knows which one.
        assert!(found("/scan", &[], &["/robot1/odom", "/robot2/odom"]).is_empty());
    }
}
