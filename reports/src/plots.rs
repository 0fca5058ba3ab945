//! Plots as SVG.

use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;
use std::ops::Range;

/// Size of a plot, pixels.
const SIZE: (u32, u32) = (700, 270);
/// Share of the values' range that is left free above and below them.
const MARGIN: f64 = 0.06;

/// A line of a plot. Where a value is missing, the line is interrupted.
pub struct Line {
    /// Name in the legend.
    pub name: String,
    /// Colour: red, green, blue.
    pub colour: [u8; 3],
    /// Points x, y.
    pub points: Vec<(f64, Option<f64>)>,
}

impl Line {
    /// Creates a line from values at times.
    pub fn new(name: &str, colour: [u8; 3], x: &[f64], y: impl Iterator<Item = Option<f64>>) -> Self {
        Self { name: name.into(), colour, points: x.iter().copied().zip(y).collect() }
    }

    fn segments(&self) -> Vec<Vec<(f64, f64)>> {
        let parts = self.points.split(|(_, y)| y.is_none());
        let segment =
            |part: &[(f64, Option<f64>)]| part.iter().filter_map(|(x, y)| Some((*x, (*y)?))).collect();
        parts.filter(|part| !part.is_empty()).map(segment).collect()
    }
}

/// Values of one distribution: name, colour, a value for each quantile.
pub type Group = (String, [u8; 3], Vec<Option<f64>>);

/// A paragraph in place of a plot without data.
fn no_data(what: &str) -> String {
    format!("<p class=\"nodata\">{what}: no data</p>")
}

/// Plots lines over time as SVG; `y` is the quantity with its unit. Says so if there is no data.
pub fn line_plot(title: &str, y: &str, lines: &[Line]) -> String {
    plot_over(title, ("time, s", y), lines)
}

/// Plots lines as SVG; `axes` are the quantities with their units. Says so if there is no data.
pub fn plot_over(title: &str, axes: (&str, &str), lines: &[Line]) -> String {
    let values = || lines.iter().flat_map(|line| &line.points).filter_map(|(x, y)| Some((*x, (*y)?)));
    let Some(ranges) = ranges(values()) else { return no_data(title) };
    let mut svg = String::new();
    match draw_lines(&mut svg, (title, axes.0, axes.1), lines, ranges) {
        Ok(()) => svg,
        Err(why) => format!("<p class=\"nodata\">{title}: cannot be drawn: {why}</p>"),
    }
}

/// Returns the ranges of both axes, with a margin; `None` without values.
fn ranges(values: impl Iterator<Item = (f64, f64)>) -> Option<(Range<f64>, Range<f64>)> {
    let mut bounds: Option<[f64; 4]> = None;
    for (x, y) in values.filter(|(x, y)| x.is_finite() && y.is_finite()) {
        let [x0, x1, y0, y1] = bounds.unwrap_or([x, x, y, y]);
        bounds = Some([x0.min(x), x1.max(x), y0.min(y), y1.max(y)]);
    }
    let [x0, x1, y0, y1] = bounds?;
    let least = if y0 >= 0.0 { 0.0 } else { y0 };
    let span = (y1 - least).max(1e-6);
    let below = if least == 0.0 { 0.0 } else { MARGIN * span };
    Some((x0..x1.max(x0 + 1.0), least - below..y1.max(least + 1e-6) + MARGIN * span))
}

/// Returns the digits behind the point of labels on an axis of this length.
fn digits(span: f64) -> usize {
    match span {
        _ if span > 10.0 => 0,
        _ if span > 1.0 => 1,
        _ if span > 0.1 => 2,
        _ => 3,
    }
}

type DrawResult = Result<(), Box<dyn std::error::Error>>;

fn draw_lines(
    svg: &mut String,
    (title, x_name, y_name): (&str, &str, &str),
    lines: &[Line],
    (x, y): (Range<f64>, Range<f64>),
) -> DrawResult {
    let digits = digits(y.end - y.start);
    let root = SVGBackend::with_string(svg, SIZE).into_drawing_area();
    root.fill(&WHITE)?;
    let mut chart = ChartBuilder::on(&root)
        .margin(10)
        .caption(title, ("sans-serif", 17))
        .x_label_area_size(38)
        .y_label_area_size(58)
        .build_cartesian_2d(x, y)?;
    chart
        .configure_mesh()
        .x_desc(x_name)
        .y_desc(y_name)
        .light_line_style(WHITE)
        .bold_line_style(RGBColor(225, 225, 225))
        .x_label_formatter(&|value| format!("{value:.0}"))
        .y_label_formatter(&move |value| format!("{value:.digits$}"))
        .label_style(("sans-serif", 13))
        .axis_desc_style(("sans-serif", 14))
        .draw()?;
    for line in lines {
        let [red, green, blue] = line.colour;
        let style = RGBColor(red, green, blue).stroke_width(2);
        for (index, segment) in line.segments().into_iter().enumerate() {
            let drawn = chart.draw_series(LineSeries::new(segment, style))?;
            if index == 0 {
                drawn
                    .label(line.name.clone())
                    .legend(move |(x, y)| PathElement::new(vec![(x, y), (x + 18, y)], style));
            }
        }
    }
    draw_legend(&mut chart, SeriesLabelPosition::LowerRight)?;
    root.present()?;
    Ok(())
}

/// A chart of numbers over numbers, drawn as SVG.
type PlotContext<'a, 'b> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;

/// Draws the names of what is plotted.
fn draw_legend<'a, 'b: 'a>(chart: &mut PlotContext<'a, 'b>, position: SeriesLabelPosition) -> DrawResult {
    let mut labels = chart.configure_series_labels();
    labels.position(position).background_style(WHITE.mix(0.85)).border_style(RGBColor(200, 200, 200));
    labels.label_font(("sans-serif", 13)).draw()?;
    Ok(())
}

/// Plots quantiles of several distributions side by side, as bars: `names` of the quantiles, values of each distribution.
pub fn quantile_plot(title: &str, y: &str, names: &[&str], groups: &[Group]) -> String {
    let largest = groups.iter().flat_map(|(.., values)| values.iter().flatten()).copied().fold(0.0, f64::max);
    if largest <= 0.0 {
        return no_data(title);
    }
    let mut svg = String::new();
    match draw_bars(&mut svg, (title, y), names, groups, largest * (1.0 + MARGIN)) {
        Ok(()) => svg,
        Err(why) => format!("<p class=\"nodata\">{title}: cannot be drawn: {why}</p>"),
    }
}

fn draw_bars(
    svg: &mut String,
    (title, y_name): (&str, &str),
    names: &[&str],
    groups: &[Group],
    top: f64,
) -> DrawResult {
    let digits = digits(top);
    let root = SVGBackend::with_string(svg, SIZE).into_drawing_area();
    root.fill(&WHITE)?;
    let mut chart = ChartBuilder::on(&root)
        .margin(10)
        .caption(title, ("sans-serif", 17))
        .x_label_area_size(30)
        .y_label_area_size(58)
        .build_cartesian_2d(0.0..names.len() as f64, 0.0..top)?;
    chart
        .configure_mesh()
        .disable_x_mesh()
        .disable_x_axis()
        .y_desc(y_name)
        .y_label_formatter(&move |value| format!("{value:.digits$}"))
        .light_line_style(WHITE)
        .draw()?;
    // A fifth of each place is free.
    let width = 0.8 / groups.len() as f64;
    for (group, (name, [red, green, blue], values)) in groups.iter().enumerate() {
        let style = RGBColor(*red, *green, *blue).filled();
        let bars = values.iter().enumerate().filter_map(|(place, value)| {
            let left = place as f64 + 0.1 + width * group as f64;
            Some(Rectangle::new([(left, 0.0), (left + width * 0.9, (*value)?)], style))
        });
        chart
            .draw_series(bars)?
            .label(name.clone())
            .legend(move |(x, y)| Rectangle::new([(x, y - 5), (x + 14, y + 5)], style));
    }
    for (place, name) in names.iter().enumerate() {
        let at = chart.plotting_area().map_coordinate(&(place as f64 + 0.5, 0.0));
        root.draw(&Text::new((*name).to_owned(), (at.0 - 16, at.1 + 8), ("sans-serif", 14)))?;
    }
    draw_legend(&mut chart, SeriesLabelPosition::UpperLeft)?;
    root.present()?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_has_no_data_says_so() {
        let line = Line { name: "robot1".into(), colour: [0; 3], points: vec![(0.0, None), (1.0, None)] };
        assert!(line_plot("coverage", "m2", &[line]).contains("coverage: no data"));
        assert!(
            quantile_plot("jitter", "ms", &["median"], &[("robot1".into(), [0; 3], vec![None])])
                .contains("no data")
        );
    }

    #[test]
    fn a_gap_interrupts_the_line() {
        let points = [Some(1.0), Some(2.0), None, Some(4.0)];
        let line = Line::new("robot1", [0, 0, 255], &[0.0, 1.0, 2.0, 3.0], points.into_iter());
        assert_eq!(line.segments(), [vec![(0.0, 1.0), (1.0, 2.0)], vec![(3.0, 4.0)]]);
        let svg = line_plot("rate", "Hz", &[line]);
        assert!(svg.starts_with("<svg") && svg.contains("robot1"), "{svg}");
    }
}
