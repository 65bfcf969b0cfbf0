// Screen-space statistics of every splat for density control: the gradient of its mean in normalised device
// coordinates, whether it was visible, and its radius in pixels. FIRST starts a step; LAST ends it and adds it to the
// statistics. The sums of a step with several renders pass from one launch to the next. If ROWS is 1, the splats are a
// subset of the rows. If VIEWS is 1, the norms of the renders' gradients are averaged over those that show the splat.
// One invocation per row.
#import gpu::elements
#import gpu::nowhere
#const FIRST, LAST, ROWS, VIEWS

struct View {
    count: u32,
    // Half the size of the image in pixels.
    half_width: f32,
    half_height: f32,
    has_gradient: u32,
    // The number of renders of the step.
    renders: f32,
}

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> gradients_px: array<f32>;
@group(0) @binding(2) var<storage, read> conics: array<f32>;
@group(0) @binding(3) var<storage, read> rank_of_splat: array<u32>;
// [N, 3]: the sum over steps of the gradient's norm, the number of steps with the splat visible, and its largest
// radius.
@group(0) @binding(4) var<storage, read> statistics: array<f32>;
// [N]: the gradient of this step so far (VIEWS: the sum of the norms in x), the number of renders that show the splat,
// and its largest radius.
@group(0) @binding(5) var<storage, read_write> sums: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read_write> new_statistics: array<f32>;
// [N]: the splat of a row, or NOWHERE.
@group(0) @binding(7) var<storage, read> splat_of_row: array<u32>;

// Three standard deviations along the longer axis, from (A, k, m).
fn radius_px(splat: u32) -> f32 {
    let a = conics[3u * splat];
    let k = conics[3u * splat + 1u];
    let m = conics[3u * splat + 2u];
    let variance_x = 1.0 / a + k * k / m;
    let variance_y = 1.0 / m;
    let gap = length(vec2<f32>(0.5 * (variance_x - variance_y), -k / m));
    return 3.0 * sqrt(0.5 * (variance_x + variance_y) + gap);
}

fn run(row: u32) {
    if (row >= view.count) {
        return;
    }
    var sum = vec4<f32>(0.0);
    if (FIRST == 0u) {
        sum = sums[row];
    }
    var splat = row;
    if (ROWS == 1u) {
        splat = splat_of_row[row];
    }
    if (splat != NOWHERE && rank_of_splat[splat] != NOWHERE) {
        if (view.has_gradient == 1u) {
            let gradient_x = gradients_px[2u * splat] * view.half_width;
            let gradient_y = gradients_px[2u * splat + 1u] * view.half_height;
            if (VIEWS == 1u) {
                sum.x += sqrt(gradient_x * gradient_x + gradient_y * gradient_y);
            } else {
                sum.x += gradient_x;
                sum.y += gradient_y;
            }
        }
        sum.z += 1.0;
        sum.w = max(sum.w, radius_px(splat));
    }
    if (LAST == 0u) {
        sums[row] = sum;
        return;
    }
    var gradient = sqrt(sum.x * sum.x + sum.y * sum.y);
    if (VIEWS == 1u) {
        gradient = sum.x * view.renders / max(sum.z, 1.0);
    }
    new_statistics[3u * row] = statistics[3u * row] + gradient;
    new_statistics[3u * row + 1u] = statistics[3u * row + 1u] + min(sum.z, 1.0);
    new_statistics[3u * row + 2u] = max(statistics[3u * row + 2u], sum.w);
}
