//! A scene as a picture: its solids are drawn from the farthest to the nearest (painter's algorithm).

use maud::{Markup, html};

use crate::solid::{Camera, Shape, Solid, Vector, dot, scaled, sum};

/// How deep solids may penetrate each other and still count as separate, meters.
const TOUCH: f64 = 0.01;

/// Direction to the light, about of unit length.
const LIGHT: Vector = [0.35, -0.45, 0.82];

/// Number of corners of the circle that rounds a cylinder's ends.
const CORNERS: usize = 20;

/// The section that a picture shows: smallest and largest coordinates in the camera's picture, meters.
pub(crate) type View = [[f64; 2]; 2];

/// Returns a view of all solids that move between scenes and of all transparent ones, which mark goals. It has a
/// margin, and its height is three quarters of its width.
pub(crate) fn view(camera: &Camera, scenes: &[Vec<Solid>]) -> View {
    // Every scene has the same solids in the same order.
    let moves = |index: usize, solid: &Solid| {
        let mut others = scenes.iter().filter_map(|scene| scene.get(index));
        solid.color[3] < 1.0 || others.any(|other| distance(solid, other) > 1e-3)
    };
    let solids = scenes.iter().flat_map(|scene| scene.iter().enumerate());
    let seen = solids.filter_map(|(index, solid)| moves(index, solid).then_some(solid));
    let mut view = [[f64::INFINITY; 2], [f64::NEG_INFINITY; 2]];
    for [least, greatest] in seen.map(|solid| camera.extent(solid)) {
        for axis in 0..2 {
            view[0][axis] = view[0][axis].min(least[axis]);
            view[1][axis] = view[1][axis].max(greatest[axis]);
        }
    }
    let [center, half] =
        [0.5, -0.5].map(|sign| [0, 1].map(|axis| 0.5 * view[1][axis] + sign * view[0][axis]));
    let high = 1.12 * half[1].max(half[0] * 0.75).max(0.05);
    let half = [high / 0.75, high];
    [[0, 1].map(|axis| center[axis] - half[axis]), [0, 1].map(|axis| center[axis] + half[axis])]
}

/// Returns the distance between the centers of two solids.
fn distance(one: &Solid, other: &Solid) -> f64 {
    let apart = sum(one.center(), scaled(other.center(), -1.0));
    dot(apart, apart).sqrt()
}

/// Draws solids as an SVG element to be nested in another one.
pub(crate) fn picture(camera: &Camera, solids: &[Solid], [least, greatest]: View) -> Markup {
    // In millimeters, so that whole numbers are precise enough.
    let [left, top] = least.map(|place| 1e3 * place);
    let [width, height] = [0, 1].map(|axis| 1e3 * (greatest[axis] - least[axis]));
    let view = format!("{left:.0} {top:.0} {width:.0} {height:.0}");
    let place = [format!("{left:.0}"), format!("{top:.0}")];
    let size = [format!("{width:.0}"), format!("{height:.0}")];
    html! {
        svg x="0" y="0" width="100%" height="100%" viewBox=(view) {
            rect x=(place[0]) y=(place[1]) width=(size[0]) height=(size[1]) fill="#EEF2F6" {}
            g stroke-width=(format!("{:.1}", width / 400.0)) stroke-linejoin="round" {
                @for index in order(camera, solids) { (drawn(camera, &solids[index])) }
            }
        }
    }
}

/// Returns the order to draw solids in, so that no solid is covered by one that is farther away.
fn order(camera: &Camera, solids: &[Solid]) -> Vec<usize> {
    let depth = |index: usize| dot(solids[index].center(), camera.toward);
    let mut left: Vec<usize> = (0..solids.len()).collect();
    left.sort_by(|&one, &other| depth(one).total_cmp(&depth(other)));
    let mut order = Vec::new();
    while !left.is_empty() {
        let is_free = |&place: &usize| {
            let solid = &solids[left[place]];
            left.iter().all(|&other| !must_precede(camera, &solids[other], solid))
        };
        // If solids cover each other in a cycle, the farthest comes first.
        let next = (0..left.len()).find(is_free).unwrap_or(0);
        order.push(left.remove(next));
    }
    order
}

/// Returns whether `one` must be drawn before `other` because `other` may cover a part of it.
fn must_precede(camera: &Camera, one: &Solid, other: &Solid) -> bool {
    let ([a_least, a_greatest], [b_least, b_greatest]) = (camera.extent(one), camera.extent(other));
    let overlap =
        (0..2).all(|axis| a_least[axis] < b_greatest[axis] && b_least[axis] < a_greatest[axis]);
    if !overlap {
        return false;
    }
    let (mut one_first, mut other_first) = (false, false);
    for (normal, _) in separating_faces(one, other) {
        let toward = dot(normal, camera.toward);
        one_first |= toward >= 0.0;
        other_first |= toward <= 0.0;
    }
    for (normal, _) in separating_faces(other, one) {
        let toward = dot(normal, camera.toward);
        other_first |= toward >= 0.0;
        one_first |= toward <= 0.0;
    }
    match (one_first, other_first) {
        (true, true) => false,
        (false, false) => dot(one.center(), camera.toward) < dot(other.center(), camera.toward),
        (one_first, _) => one_first,
    }
}

/// Returns the faces of `one` whose outer side contains all of `other`, up to [`TOUCH`].
fn separating_faces(one: &Solid, other: &Solid) -> impl Iterator<Item = (Vector, f64)> {
    let faces = one.faces().into_iter();
    faces.filter(|(normal, height)| {
        dot(other.center(), *normal) - other.reach(*normal) >= height - TOUCH
    })
}

fn drawn(camera: &Camera, solid: &Solid) -> Markup {
    let opacity = format!("{:.2}", solid.color[3]);
    match solid.shape {
        Shape::Box { center, halves } => {
            let normals = solid.faces().into_iter().map(|(normal, _)| normal);
            let seen: Vec<(Vector, [Vector; 4])> = normals
                .enumerate()
                .filter(|(_, normal)| dot(*normal, camera.toward) > 1e-6)
                .map(|(face, normal)| (normal, corners(center, halves, face)))
                .collect();
            html! {
                @for (normal, corners) in seen {
                    (polygon(&corners.map(|corner| camera.place(corner)), &shaded(solid, normal), &opacity))
                }
            }
        }
        Shape::Ball { center, radius } => {
            let [x, y] = camera.place(center).map(millimeters);
            let color = shaded(solid, camera.toward);
            html! {
                circle cx=(x) cy=(y) r=(millimeters(radius)) fill=(color) stroke=(color)
                    fill-opacity=(opacity) {}
            }
        }
        Shape::Cylinder { ends, radius } => {
            let outline = tube(camera, ends, radius);
            polygon(&outline, &shaded(solid, camera.toward), &opacity)
        }
    }
}

/// Returns the corners of a box's face. Each axis has two faces: first the one in its direction, then the opposite one.
fn corners(center: Vector, halves: [Vector; 3], face: usize) -> [Vector; 4] {
    let axis = face / 2;
    let out = scaled(halves[axis], if face.is_multiple_of(2) { 1.0 } else { -1.0 });
    let (one, other) = (halves[(axis + 1) % 3], halves[(axis + 2) % 3]);
    [(1.0, 1.0), (1.0, -1.0), (-1.0, -1.0), (-1.0, 1.0)].map(|(along_one, along_other)| {
        let in_face = sum(scaled(one, along_one), scaled(other, along_other));
        sum(sum(center, out), in_face)
    })
}

/// Returns the outline of a cylinder with round ends, since cylinders are parts of capsules.
fn tube(camera: &Camera, ends: [Vector; 2], radius: f64) -> Vec<[f64; 2]> {
    let [from, to] = ends.map(|end| camera.place(end));
    let angle = (to[1] - from[1]).atan2(to[0] - from[0]);
    let arc = |center: [f64; 2], start: f64| {
        (0..=CORNERS / 2).map(move |corner| {
            let turned = start + std::f64::consts::TAU * corner as f64 / CORNERS as f64;
            [center[0] + radius * turned.cos(), center[1] + radius * turned.sin()]
        })
    };
    let quarter = std::f64::consts::FRAC_PI_2;
    arc(to, angle - quarter).chain(arc(from, angle + quarter)).collect()
}

fn polygon(corners: &[[f64; 2]], color: &str, opacity: &str) -> Markup {
    let points: Vec<String> = corners
        .iter()
        .map(|place| format!("{},{}", millimeters(place[0]), millimeters(place[1])))
        .collect();
    html! {
        polygon points=(points.join(" ")) fill=(color) stroke=(color) fill-opacity=(opacity) {}
    }
}

fn millimeters(meters: f64) -> String {
    format!("{:.1}", 1e3 * meters)
}

/// Returns the color of a face: the more it faces the light, the brighter.
fn shaded(solid: &Solid, normal: Vector) -> String {
    let light = 0.62 + 0.38 * dot(normal, LIGHT).max(0.0);
    let [red, green, blue] =
        [0, 1, 2].map(|part| (255.0 * (solid.color[part] * light).clamp(0.0, 1.0)).round() as u8);
    format!("#{red:02X}{green:02X}{blue:02X}")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cuboid(center: Vector, half: Vector) -> Solid {
        let [x, y, z] = half;
        let halves = [[x, 0.0, 0.0], [0.0, y, 0.0], [0.0, 0.0, z]];
        let shape = Shape::Box { center, halves };
        Solid { name: "box".into(), shape, color: [0.5, 0.5, 0.5, 1.0] }
    }

    fn ball(center: Vector) -> Solid {
        let shape = Shape::Ball { center, radius: 0.1 };
        Solid { name: "ball".into(), shape, color: [0.5, 0.5, 0.5, 1.0] }
    }

    #[test]
    fn nearer_solids_are_drawn_later() {
        let camera = Camera::looking_from(0.0, 0.0);
        let solids = [ball([1.0, 0.0, 0.0]), ball([3.0, 0.05, 0.0]), ball([2.0, 0.0, 0.05])];
        assert_eq!(order(&camera, &solids), [0, 2, 1]);
    }

    #[test]
    fn what_lies_on_a_table_is_drawn_after_it() {
        // The cube is at the far end of the table, whose center is nearer.
        let camera = Camera::looking_from(0.0, 30.0);
        let cube = cuboid([-0.9, 0.0, 0.05], [0.05; 3]);
        let table = cuboid([0.0, 0.0, -0.2], [1.0, 1.0, 0.2]);
        assert_eq!(order(&camera, &[cube.clone(), table.clone()]), [1, 0]);
        // A ball below the table is drawn before it.
        let below = ball([0.3, 0.0, -0.6]);
        assert_eq!(order(&camera, &[table, cube, below]), [2, 0, 1]);
    }

    #[test]
    fn the_view_holds_what_moves() {
        let camera = Camera::looking_from(0.0, 0.0);
        let floor = cuboid([0.0, 0.0, -1.0], [9.0; 3]);
        let scenes = [0.0, 2.0].map(|y| vec![floor.clone(), ball([0.0, y, 0.0])]);
        let [[left, top], [right, bottom]] = view(&camera, &scenes);
        assert!(left < -0.1 && right > 2.1 && right < 3.0, "{left} {right}");
        assert!(((right - left) * 0.75 - (bottom - top)).abs() < 1e-12);
    }
}
