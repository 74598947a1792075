//! A plot as SVG: lines with a label each; x on a log scale, y from zero, or on a log scale where it goes over
//! [`DECADES`].
//!
//! Invariant: the bytes depend on the points alone (no fonts are measured, no clock is read).

use anyhow::anyhow;
use plotters::coord::combinators::LogCoord;
use plotters::coord::ranged1d::ValueFormatter;
use plotters::prelude::*;

/// Size of a plot, pixels.
const SIZE: (u32, u32) = (720, 420);
/// From greatest over least on, y is on a log scale: on a plain one the least would lie on the axis.
const DECADES: f64 = 100.0;
/// Colours of the lines, told apart also by people who see no red or no green (Okabe and Ito, 2008).
const COLORS: [RGBColor; 6] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
];

/// The points of one line, sorted by x.
pub(crate) struct Line {
    label: String,
    pub(crate) points: Vec<(f64, f64)>,
}

impl Line {
    /// Those of `points` (x, y) that can be drawn: finite, with x above zero.
    pub(crate) fn new(label: &str, mut points: Vec<(f64, f64)>) -> Line {
        points.retain(|(x, y)| *x > 0.0 && x.is_finite() && y.is_finite());
        points.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
        Line { label: label.to_owned(), points }
    }
}

/// The SVG text, by the titles of the axes. `lines` is not empty, nor is any of them.
pub(crate) fn render(lines: &[Line], x_title: &str, y_title: &str) -> anyhow::Result<String> {
    let mut svg = String::new();
    draw(&mut svg, lines, x_title, y_title).map_err(|error| anyhow!("{error}"))?;
    Ok(if svg.ends_with('\n') { svg } else { svg + "\n" })
}

fn draw(
    svg: &mut String,
    lines: &[Line],
    x_title: &str,
    y_title: &str,
) -> Result<(), Box<dyn std::error::Error>> {
    let points = || lines.iter().flat_map(|line| &line.points);
    let x_low = points().map(|p| p.0).fold(f64::INFINITY, f64::min);
    let x_high = points().map(|p| p.0).fold(0.0, f64::max);
    // Nothing but zeros still gets an axis.
    let y_high = points().map(|p| p.1).fold(f64::MIN_POSITIVE, f64::max);
    let y_low = points().map(|p| p.1).fold(f64::INFINITY, f64::min);

    let area = SVGBackend::with_string(svg, SIZE).into_drawing_area();
    area.fill(&WHITE)?;
    let x_range = (0.8 * x_low..1.25 * x_high).log_scale();
    let mut builder = ChartBuilder::on(&area);
    builder.margin(12).x_label_area_size(44).y_label_area_size(84);
    if y_low > 0.0 && y_high > DECADES * y_low {
        let y_range = (0.5 * y_low..2.0 * y_high).log_scale();
        draw_lines(builder.build_cartesian_2d(x_range, y_range)?, lines, x_title, y_title)?;
    } else {
        draw_lines(builder.build_cartesian_2d(x_range, 0.0..1.1 * y_high)?, lines, x_title, y_title)?;
    }
    area.present()?;
    Ok(())
}

type Chart<'a, Y> = ChartContext<'a, SVGBackend<'a>, Cartesian2d<LogCoord<f64>, Y>>;

fn draw_lines<'a, Y: Ranged<ValueType = f64> + ValueFormatter<f64>>(
    mut chart: Chart<'a, Y>,
    lines: &[Line],
    x_title: &str,
    y_title: &str,
) -> Result<(), Box<dyn std::error::Error>> {
    chart
        .configure_mesh()
        .light_line_style(WHITE)
        .x_desc(x_title)
        .y_desc(y_title)
        .x_label_formatter(&|value| short(*value))
        .y_label_formatter(&|value| short(*value))
        .draw()?;
    for (line, color) in lines.iter().zip(COLORS.iter().cycle()) {
        chart
            .draw_series(LineSeries::new(line.points.iter().copied(), color.stroke_width(2)))?
            .label(line.label.as_str())
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], color.stroke_width(2)));
        chart.draw_series(line.points.iter().map(|point| Circle::new(*point, 4, color.filled())))?;
    }
    // Where lines that fall, or rise, do not come.
    let fall: f64 = lines.iter().map(|line| line.points[0].1 - line.points[line.points.len() - 1].1).sum();
    let place = if fall > 0.0 { SeriesLabelPosition::UpperRight } else { SeriesLabelPosition::UpperLeft };
    chart
        .configure_series_labels()
        .position(place)
        .background_style(WHITE.mix(0.8))
        .border_style(BLACK)
        .draw()?;
    Ok(())
}

/// `1.5M`, `20k`, `0.25`: a tick's label.
fn short(value: f64) -> String {
    for (unit, name) in [(1e9, "G"), (1e6, "M"), (1e3, "k")] {
        if value.abs() >= unit {
            return format!("{}{name}", trimmed(value / unit));
        }
    }
    if value != 0.0 && value.abs() < 0.01 { format!("{value:.0e}") } else { trimmed(value) }
}

/// Two decimals at most, no zeros at the end.
fn trimmed(value: f64) -> String {
    let text = format!("{value:.2}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_short() {
        assert_eq!(
            [short(1_500_000.0), short(20_000.0), short(0.25), short(0.0), short(0.001)],
            ["1.5M", "20k", "0.25", "0", "1e-3"]
        );
    }

    #[test]
    fn one_point_and_zeros_still_give_a_plot() {
        let lines = [Line { label: "a".into(), points: vec![(5.0, 0.0)] }];
        let svg = render(&lines, "triangle_count", "holes").unwrap();
        assert!(svg.starts_with("<svg") && svg.trim_end().ends_with("</svg>"));
        assert_eq!(svg, render(&lines, "triangle_count", "holes").unwrap());
    }

    #[test]
    fn what_is_a_thousandth_of_the_rest_is_told_apart() {
        let heights = |points: [f64; 3]| {
            let points = points.into_iter().map(|y| (1.0, y)).collect();
            let svg = render(&[Line { label: "a".into(), points }], "triangle_count", "error").unwrap();
            let circles = svg.lines().filter(|line| line.contains("<circle"));
            circles
                .map(|line| {
                    let tail = line.split("cy=\"").nth(1).unwrap();
                    tail.split('"').next().unwrap().parse::<i32>().unwrap()
                })
                .collect::<Vec<_>>()
        };
        let [low, middle, high] = heights([0.01, 0.1, 10.0])[..] else { panic!("three points") };
        assert!(low - middle > 40 && middle - high > 80, "{low} {middle} {high}");
        let [low, middle, high] = heights([1.0, 2.0, 3.0])[..] else { panic!("three points") };
        assert!(((low - middle) - (middle - high)).abs() <= 1, "{low} {middle} {high}");
    }
}
