//! Finds what changed in a map since it was published last, for map_msgs/OccupancyGridUpdate.

use msg::{GridHeader, GridView, IndexRect};

/// A copy of the map that was published last, kept only while somebody subscribes to its updates.
#[derive(Default)]
pub struct ChangedAreaFinder {
    header: GridHeader,
    cells: Vec<i8>,
}

impl ChangedAreaFinder {
    /// Returns the smallest rectangle of cells that differ from the map before, and keeps this one.
    ///
    /// It is the whole map if there was none before, and `None` if nothing changed, or if size, resolution or origin
    /// did: then only the whole map tells.
    pub fn changed_area(&mut self, map: GridView<'_>) -> Option<IndexRect> {
        let geometry =
            |header: &GridHeader| (header.width, header.height, header.resolution_m, header.origin);
        let is_first = self.cells.is_empty();
        let area = if is_first {
            Some(IndexRect::with_size(map.header.width, map.header.height))
        } else if geometry(&self.header) == geometry(map.header) {
            changed_cells(&self.cells, map.cells, map.header.width as usize)
        } else {
            None
        };
        self.header = *map.header;
        self.cells.clear();
        self.cells.extend_from_slice(map.cells);
        area.filter(|area| !area.is_empty())
    }

    /// Forgets the map: nobody wants its updates.
    pub fn clear(&mut self) {
        self.cells = Vec::new();
    }
}

/// Returns the smallest rectangle that contains all cells that differ, in rows of `width` cells.
fn changed_cells(before: &[i8], now: &[i8], width: usize) -> Option<IndexRect> {
    let rows = before.chunks_exact(width.max(1)).zip(now.chunks_exact(width.max(1)));
    let mut area: Option<IndexRect> = None;
    for (y, (before, now)) in rows.enumerate().filter(|(_, (before, now))| before != now) {
        let differs = |(before, now): (&i8, &i8)| before != now;
        let (Some(first), Some(last)) =
            (before.iter().zip(now).position(differs), before.iter().zip(now).rposition(differs))
        else {
            continue;
        };
        let (y, x0, x1) = (y as i64, first as i64, last as i64 + 1);
        let begun = area.unwrap_or(IndexRect { x0, y0: y, x1, y1: y });
        area = Some(IndexRect { x0: begun.x0.min(x0), y0: begun.y0, x1: begun.x1.max(x1), y1: y + 1 });
    }
    area
}

#[cfg(test)]
mod tests {
    use super::*;

    fn header(width: u32, height: u32) -> GridHeader {
        GridHeader { width, height, resolution_m: 0.05, ..GridHeader::default() }
    }

    #[test]
    fn the_changed_area_is_the_smallest_that_has_every_change() {
        let header_4x3 = header(4, 3);
        let mut updates = ChangedAreaFinder::default();
        let mut cells = [0; 12];
        let mut changed =
            |header: &GridHeader, cells: &[i8]| updates.changed_area(GridView::new(header, cells).unwrap());
        assert_eq!(
            changed(&header_4x3, &cells),
            Some(IndexRect::with_size(4, 3)),
            "the first map is all new"
        );
        assert_eq!(changed(&header_4x3, &cells), None);
        (cells[6], cells[9]) = (1, 1);
        assert_eq!(changed(&header_4x3, &cells), Some(IndexRect { x0: 1, y0: 1, x1: 3, y1: 3 }));
        assert_eq!(changed(&header(3, 4), &cells), None, "another size: only the whole map tells");
        assert_eq!(changed(&header(3, 4), &cells), None);
    }
}
