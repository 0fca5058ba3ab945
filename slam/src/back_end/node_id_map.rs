//! Node ids of the front end mapped to those of the back end, which leave out removed nodes.

use crate::front_end::TrajectorySample;

/// Ids of the nodes in the front end and in the back end.
#[derive(Default)]
pub(super) struct NodeIdMap {
    /// The front end's number of each node.
    pub front_ids: Vec<u32>,
    /// Nodes that earlier front ends numbered: the present one's numbers begin after them.
    pub earlier_nodes: usize,
    /// The front end's number of the newest node, kept or not.
    pub newest_front: u32,
    /// Scans of earlier front ends, by the back end's numbers.
    pub earlier: Vec<TrajectorySample>,
}

impl NodeIdMap {
    /// The back end's number of a node of the present front end; `None` if the map does not have it.
    pub fn id_of(&self, front_id: u32) -> Option<u32> {
        let ids = &self.front_ids[self.earlier_nodes..];
        let newest = ids.len().checked_sub(1)?;
        // Numbers rise by one, but where nodes were dropped.
        let guess = newest.saturating_sub(ids[newest].checked_sub(front_id)? as usize);
        let found = match ids[guess] == front_id {
            true => guess,
            false => ids.iter().rposition(|id| *id == front_id)?,
        };
        Some((self.earlier_nodes + found) as u32)
    }

    /// Scans by the back end's node numbers: those of earlier front ends, then these.
    pub fn samples<'a>(
        &'a self,
        samples: &'a [TrajectorySample],
    ) -> impl Iterator<Item = TrajectorySample> + 'a {
        let newer = samples
            .iter()
            .filter_map(|sample| Some(TrajectorySample { node: self.id_of(sample.node)?, ..*sample }));
        self.earlier.iter().copied().chain(newer)
    }
}
