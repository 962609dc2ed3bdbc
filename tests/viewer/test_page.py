"""The page holds all it needs, and a real browser shows what its options and keys say."""

from __future__ import annotations

import base64
import contextlib
import io
import re
import webbrowser
import zlib
from pathlib import Path

import numpy as np
import pytest
from page_content import content, reddish, screenshot

import manip3d
from landmarks import assert_accessible
from manip3d import InputError, Material, Mesh, RenderError, Texture
from manip3d.viewer import _chromium, film, html, iframe, page, picture, play, view

pytestmark = pytest.mark.usefixtures("bundle")

PAPER = np.array([245, 246, 248])


def png(color: tuple[int, int, int]) -> bytes:
    from PIL import Image

    stream = io.BytesIO()
    Image.new("RGB", (4, 4), color).save(stream, format="PNG")
    return stream.getvalue()


def press(tab: _chromium.Tab, *keys: str) -> None:
    for key in keys:
        tab.evaluate(f"document.dispatchEvent(new KeyboardEvent('keydown', {{key: '{key}'}}))")


# ------------------------------------------------------------------------------- the text


def test_the_page_loads_nothing(quad: Mesh) -> None:
    text = html(quad, title="a <b> é")
    assert text.isascii()  # else a host page of another encoding would change the script's hash
    assert not re.search(r"""(src|href)\s*=\s*["']?(?!data:|blob:)[a-z]+:""", text)
    assert "<link" not in text
    assert not re.search(r"@import|url\(\s*['\"]?http", text)
    assert set(re.findall(r"https?://[^\s\"'`)<]+", text)) <= {"http://www.w3.org/1999/xhtml"}
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', text)
    assert policy is not None
    assert policy[1].startswith("default-src 'none'; script-src 'sha256-")
    assert "<title>a &lt;b&gt; &#233;</title>" in text
    assert text.count("</script>") == 2


def test_labels_titles_and_names_cannot_break_out(quad: Mesh) -> None:
    nasty = "</script><script>alert(1)</script>"
    text = html(quad, title=nasty, labels=[nasty])
    assert text.count("<script") == 2
    assert content(text)["title"] == nasty
    assert content(text)["models"][0]["label"] == nasty


def test_face_counts_stand_beside_the_labels(quad: Mesh) -> None:
    models = content(html([quad, quad], labels=["original", "light"]))["models"]
    assert [(m["label"], m["detail"]) for m in models] == [
        ("original", "2 faces"),
        ("light", "2 faces"),
    ]


def test_boundary_edges_are_placed_like_the_mesh(quad: Mesh) -> None:
    far = quad.replace(vertices=quad.vertices * 1e6 + 1e9)
    model = content(html(far))["models"][0]
    ends = np.frombuffer(base64.b64decode(model["boundary"]), "<f4").reshape(-1, 2, 3)
    assert ends.shape == (4, 2, 3)
    np.testing.assert_allclose(np.abs(ends[..., :2]), 0.5 / np.sqrt(2), rtol=1e-6)


def test_large_meshes_are_simplified_and_say_so() -> None:
    n = 30
    v, u = np.mgrid[0:n, 0:n]
    lower = (v[:-1, :-1] * n + u[:-1, :-1]).ravel()
    grid = Mesh(
        np.column_stack([u.ravel(), v.ravel(), np.sin(u.ravel())]),
        np.vstack(
            [np.column_stack([lower, lower + 1, lower + n]),
             np.column_stack([lower + 1, lower + n + 1, lower + n])]
        ),
    )  # fmt: skip
    detail = content(html(grid, max_faces=500))["models"][0]["detail"]
    assert re.fullmatch(r"1,682 faces, shown with (500|49\d)", detail)


def test_textures_travel_in_the_page(quad: Mesh) -> None:
    pytest.importorskip("PIL.Image")
    material = Material(textures={"base_color": Texture(data=png((255, 0, 0)))})
    textured = quad.replace(materials=(material,), face_material=[0, 0])
    glb = base64.b64decode(content(html(textured))["models"][0]["glb"])
    assert glb[:4] == b"glTF"
    assert png((255, 0, 0)) in glb


def test_a_missing_texture_warns(quad: Mesh, tmp_path: Path) -> None:
    material = Material(textures={"base_color": Texture(path="gone.png")})
    mesh = quad.replace(
        materials=(material,), face_material=[0, 0], source=str(tmp_path / "mesh.obj")
    )
    with pytest.warns(UserWarning, match=r"gone\.png cannot be read"):
        html(mesh)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"labels": ["a", "b"]}, "got 2 labels for 1 meshes"),
        ({"max_faces": 0}, "max_faces"),
        ({"up": "x"}, "up"),
        ({"elevation": float("nan")}, "elevation"),
        ({"shading": "toon"}, "shading"),
    ],
)
def test_bad_options_are_named(quad: Mesh, options: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        html(quad, **options)


def test_no_mesh_is_refused() -> None:
    with pytest.raises(InputError, match="at least one mesh"):
        html([])


def test_without_the_bundle_the_cure_is_named(
    quad: Mesh, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(page, "BUNDLE", tmp_path / "dist" / "viewer.js")
    page._bundle.cache_clear()
    try:
        with pytest.raises(RenderError, match="make setup"):
            html(quad)
    finally:
        page._bundle.cache_clear()


def test_iframe_escapes_the_page(quad: Mesh) -> None:
    element = iframe(html(quad), height=300)
    assert element.count("<") == 2
    assert 'sandbox="allow-scripts"' in element
    assert "height:300px" in element


# ------------------------------------------------------------------------------- view


def test_view_writes_a_page(quad: Mesh, tmp_path: Path) -> None:
    path = manip3d.view(quad, tmp_path / "quad.html", title="quad")
    assert content(path.read_text())["title"] == "quad"
    assert [p.name for p in tmp_path.iterdir()] == ["quad.html"]


@pytest.mark.parametrize("several", [False, True])
def test_view_writes_a_picture(quad: Mesh, tmp_path: Path, several: bool) -> None:
    try:
        path = view([quad, quad] if several else quad, tmp_path / "quad.png", size=(40, 30))
    except RenderError as error:
        pytest.skip(str(error))
    from PIL import Image

    with Image.open(path) as image:
        assert image.size == ((80, 60) if several else (40, 30))


def test_view_opens_a_browser(quad: Mesh, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    opened: list[str] = []
    monkeypatch.setattr(webbrowser, "open", opened.append)
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    path = view(quad)
    assert opened == [path.as_uri()]
    assert path.parent == tmp_path
    assert content(path.read_text())["models"][0]["detail"] == "2 faces"


def test_view_opens_nothing_where_nobody_would_see_it(
    quad: Mesh, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    opened: list[str] = []
    monkeypatch.setattr(webbrowser, "open", opened.append)
    monkeypatch.setattr("sys.platform", "linux")
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER"):
        monkeypatch.delenv(name, raising=False)
    assert view(quad).exists()
    assert opened == []


def test_view_refuses_other_suffixes(quad: Mesh, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"\.html or \.png"):
        view(quad, tmp_path / "quad.jpg")


def test_a_film_holds_its_frames_in_order(quad: Mesh) -> None:
    page = content(film([quad, quad], labels=["a", "b"], rate=24, title="t"))
    assert page["film"] == {"rate": 24}
    assert [model["label"] for model in page["models"]] == ["a", "b"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"rate": 0}, "rate"),
        ({"rate": float("nan")}, "rate"),
        ({"labels": ["one"]}, "labels"),
        ({"max_faces": 0}, "max_faces"),
    ],
)
def test_bad_options_of_a_film_are_named(quad: Mesh, options: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        film([quad, quad], **options)


def test_a_film_takes_meshes_only(quad: Mesh) -> None:
    cloud = manip3d.LidarFrame(np.eye(3))
    with pytest.raises(InputError, match=r"meshes\[1\]: expected a mesh"):
        film([quad, cloud])
    with pytest.raises(InputError, match="at least one mesh"):
        film([])


def test_play_writes_pages_only(quad: Mesh, tmp_path: Path) -> None:
    assert play([quad], tmp_path / "a.html").read_text().startswith("<!DOCTYPE html>")
    with pytest.raises(InputError, match=r"\.html"):
        play([quad], tmp_path / "a.png")


# ------------------------------------------------------------------------------- the browser


def test_the_browser_plays_a_film(chromium: None, quad: Mesh) -> None:
    red = quad.replace(colors=[[255, 0, 0]] * 4)
    text = film([red, quad, quad], rate=50, azimuth=0, elevation=0)
    frame = "document.querySelector('footer output').textContent"
    slide = "(s => { s.value = %d; s.dispatchEvent(new Event('input')); })"
    with _chromium.open_page(text, (500, 400)) as tab:
        tab.evaluate("manip3d")
        assert tab.evaluate(frame) == "1 of 3"
        first = screenshot(tab)
        tab.evaluate(f"{slide % 2}(document.querySelector('footer input'))")
        assert tab.evaluate(frame) == "3 of 3"
        last = screenshot(tab)
        press(tab, " ")
        assert tab.evaluate("document.querySelector('footer button').textContent") == "Stop"
        seen = tab.evaluate(
            f"new Promise(done => {{ const seen = new Set(); const look = () => {{"
            f" seen.add({frame}); seen.size === 3 ? done(seen.size) : requestAnimationFrame(look);"
            f" }}; look(); }})"
        )
        press(tab, " ")
        stopped = tab.evaluate(frame)
        assert tab.evaluate("document.querySelector('footer button').textContent") == "Play"
        assert tab.evaluate(frame) == stopped
        # After somebody has moved the time bar it has the focus: space and letters still count.
        told = "document.querySelector('footer input').dispatchEvent(new KeyboardEvent('keydown', "
        tab.evaluate(told + "{key: ' ', bubbles: true, cancelable: true}))")
        assert tab.evaluate("document.querySelector('footer button').textContent") == "Stop"
        is_its_own = tab.evaluate(told + "{key: 'ArrowLeft', bubbles: true, cancelable: true}))")
        assert is_its_own  # nobody has taken the key from the time bar
    assert reddish(first).sum() > 10_000
    assert reddish(last).sum() == 0
    assert seen == 3


def test_the_browser_shows_each_mesh_in_its_pane(chromium: None, quad: Mesh) -> None:
    red = quad.replace(colors=[[255, 0, 0]] * 4)
    text = html([red, quad], labels=["red", "grey"], azimuth=0, elevation=0)
    with _chromium.open_page(text, (800, 500)) as tab:
        tab.evaluate("manip3d")
        image = screenshot(tab)
    red_pixels = reddish(image)
    middle = image.shape[1] // 2
    assert red_pixels[:, :middle].sum() > 20_000
    assert red_pixels[:, middle:].sum() == 0
    right = image[60:-40, middle:]
    assert (np.abs(right - PAPER).max(axis=2) > 8).sum() > 20_000


def test_a_screen_reader_is_told_what_the_view_shows(chromium: None, quad: Mesh) -> None:
    role_and_label = "['role', 'aria-label'].map(n => document.querySelector('canvas')"
    role_and_label += ".getAttribute(n)).join(': ')"
    pages = {
        "img: 3D view of before, after": html([quad, quad], labels=["before", "after"]),
        "img: 3D view of a walk": film([quad, quad], labels=["0", "1"], rate=2, title="a walk"),
        "img: 3D view of after": html([quad, quad], labels=["", "after"]),
        "img: 3D view of two quads": html([quad, quad], title="two quads"),
        "img: 3D view": html(quad),
    }
    for expected, text in pages.items():
        with _chromium.open_page(text, (400, 300)) as tab:
            tab.evaluate("manip3d")
            assert_accessible(tab.evaluate("document.documentElement.outerHTML"))
            assert tab.evaluate(role_and_label) == expected


@pytest.mark.parametrize("width", [360, 640])
def test_long_names_stay_within_a_narrow_window(chromium: None, quad: Mesh, width: int) -> None:
    name = "a_name_without_any_place_for_a_line_break_" * 5
    with _chromium.open_page(
        html([quad, quad], labels=[name, name], title=name), (640, 500)
    ) as tab:
        tab.send("Emulation.setDeviceMetricsOverride", width=width, height=500,
                 deviceScaleFactor=1, mobile=False)  # fmt: skip
        tab.evaluate("manip3d")
        assert tab.evaluate("document.documentElement.scrollWidth") == width


def test_buttons_are_named_by_the_words_on_them(chromium: None, quad: Mesh) -> None:
    names = "[...document.querySelectorAll('header button')].map(b => b.ariaLabel ?? b.innerText)"
    with _chromium.open_page(html(quad), (800, 300)) as tab:
        tab.evaluate("manip3d")
        assert tab.evaluate(names)[-3:] == ["Reset", "Dark or light (D)", "Keys (?)"]


def test_the_keys_do_what_the_help_says(chromium: None, quad: Mesh) -> None:
    material = Material(textures={"base_color": Texture(data=png((255, 0, 0)))})
    mesh = quad.replace(materials=(material,), face_material=[0, 0])
    with _chromium.open_page(html(mesh, azimuth=0, elevation=0), (500, 400)) as tab:
        tab.evaluate("manip3d")
        first = screenshot(tab)
        press(tab, "t")
        grey = screenshot(tab)
        press(tab, "b")
        bordered = screenshot(tab)
        press(tab, "b", "w")
        wired = screenshot(tab)
        press(tab, "w", "d")
        dark = screenshot(tab)
        press(tab, "d", "t", "ArrowLeft", "+", "r")
        again = screenshot(tab)
        press(tab, "?")
        help_open = tab.evaluate("document.querySelector('dialog').open")
    assert reddish(first).sum() > 10_000
    assert reddish(grey).sum() == 0
    assert reddish(bordered).sum() > 200
    center = tuple(side // 2 for side in wired.shape[:2])
    around = np.s_[center[0] - 20 : center[0] + 20, center[1] - 20 : center[1] + 20]
    assert wired[around].min() < grey[around].min() - 30
    assert dark[-2, 2].max() < 60
    np.testing.assert_allclose(again, first, atol=2)
    assert help_open


DRAWN = re.compile(  # in a PDF: a scaled image; other operators, none of which scales; its name
    rb"([-.\d]+) 0 0 ([-.\d]+) [-.\d]+ [-.\d]+ cm(?:(?! cm).)*?/(X\d+) Do", re.DOTALL
)


def printed_stretch(tab: _chromium.Tab, landscape: bool) -> float:
    """Print the page, and return how much wider its picture is than it was drawn for its height."""
    content = base64.b64decode(tab.send("Page.printToPDF", landscape=landscape)["data"])
    size = re.search(rb"/Subtype /Image\n/Width (\d+)\n/Height (\d+)\n", content)
    assert size is not None
    for stream in content.split(b"stream\n")[1::2]:
        with contextlib.suppress(zlib.error):
            before, is_drawn, _ = zlib.decompressobj().decompress(stream).partition(b" Do\n")
            if is_drawn:
                # The last matrix before the picture maps the unit square to its place.
                wide, _, _, high = map(float, before.rpartition(b" cm\n")[0].split()[-6:-2])
                return abs(wide / high) * int(size[2]) / int(size[1])
    raise AssertionError("no picture was printed")


@pytest.mark.parametrize("landscape", [False, True])
def test_paper_shows_the_picture_in_its_proportions(
    chromium: None, quad: Mesh, landscape: bool
) -> None:
    with _chromium.open_page(html([quad] * 4), (1280, 700)) as tab:
        tab.evaluate("manip3d")
        screenshot(tab)
        assert printed_stretch(tab, landscape) == pytest.approx(1.0, abs=0.01)
        # The captions stay under their pictures, and what only works on a screen is left out.
        tab.send("Emulation.setEmulatedMedia", media="print")
        tab.send("Emulation.setDeviceMetricsOverride", width=700, height=1000,
                 deviceScaleFactor=1, mobile=False)  # fmt: skip
        tops = "new Set([...document.querySelectorAll('figure')].map(f => f.offsetTop)).size"
        assert tab.evaluate(tops) == 1
        assert tab.evaluate("document.querySelector('header').innerText") == ""


def test_a_sandboxed_frame_shows_the_page(chromium: None, quad: Mesh) -> None:
    pytest.importorskip("PIL.Image")
    material = Material(textures={"base_color": Texture(data=png((255, 0, 0)))})
    mesh = quad.replace(materials=(material,), face_material=[0, 0])
    host = f"<!DOCTYPE html><body style='margin:0'>{iframe(html(mesh), height=300)}</body>"
    with _chromium.open_page(host, (500, 400)) as tab:
        for _ in range(100):  # the host cannot look into the frame
            image = screenshot(tab)
            if reddish(image).sum() > 1000:
                return
            tab.evaluate("new Promise(r => setTimeout(r, 100))")
    pytest.fail("the frame stayed empty")


def test_both_renderers_draw_the_same_outline(
    chromium: None, quad: Mesh, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("pyvista")
    covered = {}
    for name in ("pyvista", "chromium"):
        monkeypatch.setenv("MANIP3D_RENDERER", name)
        try:
            image = picture(quad, size=(160, 120), azimuth=25, background=(255, 255, 255))
        except RenderError as error:
            pytest.skip(str(error))
        covered[name] = (image < 250).any(axis=2)
    both = (covered["pyvista"] & covered["chromium"]).sum()
    either = (covered["pyvista"] | covered["chromium"]).sum()
    assert both > 0.97 * either > 3000


def test_points_whose_extent_exceeds_float32_give_a_page() -> None:
    far = np.array([[3e38, 0, 0], [-3e38, 3e38, 1]], np.float32)
    (model,) = content(html(manip3d.LidarFrame(far)))["models"]
    assert 0.0 < model["points"]["least"] < 1.0
