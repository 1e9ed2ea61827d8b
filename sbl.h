/* sbl.h - v0.2.0 - sensor based lighting: global illumination in one C header

   Do this in exactly one C or C++ file of your program:

       #define SBL_IMPLEMENTATION
       #define SBL_EGL              // optional: sbl.h can then create a headless GL context (link with -lEGL)
       #include "sbl.h"

   Other files include the header without these defines. sbl.h needs C99 or C++11, libm, and OpenGL 3.3 core or later.


   WHAT IT IS

   sbl.h computes global illumination. You give it triangles, materials, lights and a camera. It returns a picture with
   direct light and with all light that surfaces reflect to each other.

   The library measures light only at selected points and interpolates the rest:

       site      a point with a normal, where light is wanted
       sensor    the measurement at a site. It collects light from the hemisphere above the site
       look      one part of a sensor's measurement: a number of rays, or one set of views. Each look is rotated
                 differently. The result of a sensor is the mean of its looks
       reading   the result of a sensor: the light, its noise, and figures that tell whether the sensor can be trusted
       lamp      anything that sensors send rays to: an emitting triangle, a light, a bright texel of a sky picture
       store     the bounced light of the scene: one value for each cell, a small piece of a surface
       tile      a rectangle of pixels with a sensor at each of its four corners

   A sensor finds light in three ways. For lamps it computes the light of the whole lamp in closed form, and multiplies
   it by the fraction of the lamp that rays find unobstructed. For the sky it forms a weighted sum of what rays (or
   small views of the scene) find. For light that surfaces reflect, the same rays look up the store, which is made once
   per scene.

   A picture starts with large tiles. Tiles whose predicted error is large are subdivided, down to single pixels. Pixels
   between sensors are interpolated. A filter that never mixes surfaces smooths the result, which is then multiplied by
   the surface colour.

       camera --> G-buffer --> tiles --> sites --> sensors --> readings --> refine --> filter --> resolve --> final
                                           ^                                   |
                                           +-----------------------------------+   level by level, to single pixels

   The same sensors serve five purposes:

       pictures    light at the pixels of a camera                        see ON PICTURES
       lightmaps   light at the texels of a map of all surfaces           see ON LIGHTMAPS
       vertices    light at the vertices of meshes                        see ON VERTEX LIGHT
       probes      light at points in the air, from all directions        see ON PROBES
       readings    light at any points with normals that you give         see sbl_readings_desc

   The method is "Sensor based Lighting" by M. Banquiero and M. Leone. The chapter ON THE PAPER lists the differences.


   WHAT IT DOES NOT DO

   All surfaces are diffuse. There are no glossy and no transparent surfaces, and so no mirrors and no caustics; a
   metal is treated as a diffuse surface of its base colour. Textures are filtered bilinearly without mip maps, so a
   texture whose texels are smaller than a pixel shows aliasing. sbl.h opens no files and creates no windows.


   QUICK START

   This program renders a floor below a lamp into an array of floats. Compile it with: cc quick.c -lEGL -lm

       #define SBL_IMPLEMENTATION
       #define SBL_EGL
       #include "sbl.h"

       int main(void) {
           static const float corners[] = {  // a floor and a lamp above it
               -1, 0, -1,   -1, 0, 1,    1, 0, 1,    1, 0, -1,
               -.3f, 1, -.3f,   .3f, 1, -.3f,   .3f, 1, .3f,   -.3f, 1, .3f };
           static const unsigned short quad[] = { 0, 1, 2, 0, 2, 3 };
           static float picture[64 * 64 * 3];
           static sbl_material materials[2];
           static sbl_mesh meshes[2];
           sbl_scene_desc scene = { 0 };
           sbl_picture_desc view = { 0 };
           sbl_context *context;
           int i;
           for (i = 0; i < 3; i++) { materials[0].albedo[i] = 0.7f; materials[1].emission[i] = 5; }
           for (i = 0; i < 2; i++) {
               meshes[i].positions.data = corners + 12 * i;
               meshes[i].vertex_count = 4;
               meshes[i].indices.data = quad;
               meshes[i].indices.type = SBL_UINT16;
               meshes[i].index_count = 6;
               meshes[i].material = i;
           }
           scene.meshes = meshes;        scene.mesh_count = 2;
           scene.materials = materials;  scene.material_count = 2;
           view.width = view.height = 64;
           sbl_look_at(view.world_to_view, 0, 1.5f, 3, 0, 0.4f, 0, 0, 1, 0);
           sbl_perspective(view.view_to_clip, 40, 1);
           if (sbl_create(NULL, &context) != SBL_SUCCESS) return 1;
           if (sbl_set_scene(context, &scene) != SBL_SUCCESS) return 1;
           if (sbl_render_picture(context, &view) != SBL_SUCCESS) return 1;
           sbl_read_channel(context, SBL_CHANNEL_FINAL, picture, 64 * 64 * 3);
           sbl_destroy(context);
           return 0;
       }


   FUNCTIONS

   Contexts and scenes:
       sbl_create                 creates a context in the host's GL context, or in a headless GL context of its own
       sbl_destroy                frees a context and everything in it
       sbl_set_scene              replaces the scene: meshes, materials, textures, lights, sky
       sbl_set_mesh_transform     moves one mesh
       sbl_set_materials          replaces the materials of the scene
       sbl_set_lights             replaces the lights of the scene by as many others; intensity 0 turns a light off
       sbl_save_store             writes the stored bounced light, for a later run
       sbl_load_store             reads stored bounced light that an earlier run has written

   Work in one call:
       sbl_render_picture         renders a picture
       sbl_gather_readings        measures the light at any points with normals
       sbl_bake_lightmap          bakes a lightmap
       sbl_bake_vertices          bakes the light at the vertices of meshes
       sbl_bake_probes            bakes the light at points in the air

   The same work in steps (begin once, step until done, end):
       sbl_begin_picture          starts a picture
       sbl_begin_readings         starts readings
       sbl_begin_lightmap         starts a lightmap, which takes the place of a picture
       sbl_begin_vertices         starts light at vertices
       sbl_begin_probes           starts probes
       sbl_step                   works for about the given number of seconds
       sbl_progress               returns how much is done, 0 to 1
       sbl_end                    stops and frees whatever was begun, and frees a finished picture or lightmap

   Results:
       sbl_read_channel           copies one channel of a picture or lightmap into a float array
       sbl_channel_texture        returns the GL texture of a channel
       sbl_channel_components     returns the number of floats per pixel of a channel
       sbl_inspect_sensor         shows what one sensor sees, weighs and sums: "why is this pixel dark?"

   Helpers:
       sbl_look_at                makes a world_to_view matrix
       sbl_perspective            makes a view_to_clip matrix
       sbl_encode_srgb8           converts radiance to 8-bit sRGB, for PNG files and screens

   Descriptors with each zero replaced by its default:
       sbl_context_desc_defaults
       sbl_picture_desc_defaults
       sbl_readings_desc_defaults
       sbl_lightmap_desc_defaults
       sbl_vertices_desc_defaults
       sbl_probes_desc_defaults

   Queries (each returns a struct, which is all zeroes for a NULL context):
       sbl_query_desc             the context's descriptor, with its defaults filled in
       sbl_query_bounds           the bounding box of the scene
       sbl_query_capabilities     the GL version, and which optional GL features exist and are used
       sbl_query_programs         the number of GL programs compiled so far, and the seconds spent compiling them
       sbl_query_stats            counts and times of the work that was begun last
       sbl_query_memory           bytes in use now and at peak

   Names:
       sbl_version                "0.2.0"
       sbl_result_string          describes a result
       sbl_log_item_string        describes a log item


   ON UNITS

   Radiance (linear, not gamma encoded) and lengths may have any unit. Use one unit of each kind throughout a scene.
   Results are accurate for scenes that are 5e-10 to 6e9 units across, at a distance of at most 4,000 times their size
   from the origin; sbl_set_scene warns about others. A value that overflows never becomes NaN.

   For a surface point p with normal n:

       E(p) = integral over the hemisphere of L(p, w) cos(theta) dw      the irradiance
       R(p) = E(p) / pi                                                  a uniform sky of radiance 1 gives R = 1
       final = emission(p) + albedo(p) * R(p)

   R is the quantity that sensors measure. This manual calls it R everywhere; fields and channels call it radiance. Both
   sides of a surface reflect, and both emit unless SBL_MATERIAL_ONE_SIDED_EMISSION is set.

   Matrices are column-major, as in GL. View space looks along -z. Pixel (0, 0) is the top left pixel. A pixel is
   sampled at its centre. Arrays and textures hold the top row first: texture coordinate v = 0 is the top edge.


   ON ZEROS

   Fill a descriptor with zeroes and set only the fields that you care about. Zero is the default of every field; where
   zero itself would be a meaningful value, a negative number asks for it ("none" or "off"). For example, filter_radius
   = 0 selects the default radius of 2 pixels, and -1 turns the filter off. Each field's comment names its default.

   Items are numbered from 0 (sbl_mesh.material), but textures from 1 (sbl_material.albedo_texture); 0 is no texture.


   ON PICTURES

   sbl_render_picture renders the scene as the camera of sbl_picture_desc sees it. Read the result with
   sbl_read_channel or sbl_channel_texture. The most used channels are SBL_CHANNEL_FINAL (the lit picture) and
   SBL_CHANNEL_RADIANCE (R, light without surface colour).

   sbl_picture_desc.options.mode selects the light that is computed, see sbl_mode. The default, SBL_MODE_GI, computes
   all light; SBL_MODE_DIRECT takes a third to half of its time. Geometry that only the host can draw (for example with
   a vertex shader) is drawn by a callback, see sbl_draw_view.


   ON SCREENS

   Radiance has no upper limit, a screen has one. sbl_picture_desc.tone chooses a view transform (see sbl_tone), and
   SBL_CHANNEL_DISPLAY is then the picture that it makes, with values from 0 to 1. The transform is applied to each
   anti-aliasing sample, so that the edges of lamps are as smooth as others. To write a file or fill an 8-bit texture:

       static float shown[640 * 480 * 3];
       static unsigned char bytes[640 * 480 * 3];
       sbl_picture_desc desc = { 0 };
       desc.tone = SBL_TONE_NEUTRAL;
       desc.auto_exposure = 1;
       sbl_render_picture(context, &desc);
       sbl_read_channel(context, SBL_CHANNEL_DISPLAY, shown, 640 * 480 * 3);
       sbl_encode_srgb8(bytes, shown, 640 * 480 * 3, 1);

   auto_exposure goes by the light that arrives, as a light meter held into the scene does, and not by how bright the
   surfaces are: white rooms stay white. The mean logarithm of the luminance of R, without the darkest and the
   brightest 5 % of the pixels, is shown like a radiance of 0.71. If the mean logarithm of the brightest 5 % of
   FINAL would exceed a radiance of 2.8, the exposure is lowered, by at most 1.5 stops. sbl_stats.picture.exposure tells
   the result. Exposure and tone change no other channel.


   ON THE TARGET ERROR

   sbl_picture_desc.target_error is the error of R that you accept: the root mean square over the visible pixels, in
   luminance, divided by the mean luminance of R there. 0.02 means 2 %. The luminance of a colour is 0.2126 r + 0.7152 g
   + 0.0722 b. The times for targets of 8, 4, 2 and 1 % are about in the ratio 1 : 1.5 : 3 : 6.

   With the default target, each sensor takes at most 16 looks; target_error tells how many rays these have. The limit
   bounds the time where light comes through windows, and there the picture may miss the target. If you set target_error
   yourself, a sensor may take up to 512 looks, which is 16 to 32 times as many rays.

   A picture begins with few sensors that take one look each. They predict the error of each tile. It has two parts:

       noise           estimated from how much rays in neighbouring directions differ, less what interpolation and the
                       filter average out
       interpolation   the part of the light that interpolation between sensors misses, estimated from second
                       differences of the light between sensors

   The library then spends rays where they reduce the error most for their cost. Sensors take further looks, or tiles
   are subdivided, down to single pixels, until the predicted error of the picture reaches the target.

   SBL_CHANNEL_ERROR is the prediction for each pixel: the standard error of the luminance of R, in the unit of R.
   sbl_stats.picture.expected_error is the prediction for the whole picture, as a share of the mean. A host may read
   both early, and stop.

   SBL_MODE_GI adds a third part: the error of the stored light, estimated from the differences between the points of a
   cell. Sensors cannot reduce it; a larger max_bounce_cells does. The sensors' own part is never driven below 0.84 of
   the target, even where the third part alone exceeds it; the picture then ends with SUCCESS and an expected_error
   above the target. sbl_stats.picture.stored_error is the third part alone.

   If most light comes through windows or from a few other bright places, the picture first traces rays that find these
   places. Sensors then send most of their rays there, which saves half to two thirds of all rays.

   Accuracy of the prediction, measured at targets of 8, 4, 2 and 1 % against references: the true error is 0.6 to 1.2
   times the prediction where R is known in closed form and in the Cornell box. With bounced light it is 1.2 to 1.9
   times the prediction in three furnished rooms, and 3 to 4 times in a room of 361,000 triangles and in a building that
   the picture shows in part. Three errors cannot be predicted: a shadow between all sensors of the first level; a
   window that no ray has met; and changes of the stored light inside a cell that is larger than the geometry beside it.


   ON LIGHTS

   Light has three sources. Surfaces emit (sbl_material.emission). Point, spot and directional lights shine without
   being visible themselves (sbl_light). The sky shines where nothing is hit: with a constant radiance
   (sbl_scene_desc.sky), and with a picture or a function (sbl_environment).

   The light of a lamp is exact where the whole lamp is visible, and black where none of it is, because rays towards the
   lamp only measure the fraction that arrives. In between, its noise is that of the fraction. An emission texture is
   sampled where the rays meet the lamp, which adds noise even without obstruction.

   A sensor sends few rays towards lamps if all of them arrive or all are blocked, more if they disagree. Up to 32
   lights without size get only one ray each. If there are more than 256 lamps, those that are far away for their size
   form clusters, and each ray picks one lamp of a cluster, with a probability proportional to the light it gives. The
   mean stays correct, the noise is a few percent, and more lamps hardly raise the cost of a sensor.

   Texels of a sky picture that are brighter than four times its mean are lamps, so that a sun in the picture casts a
   clean shadow. Rays over the hemisphere meet the rest of the sky.


   ON BOUNCED LIGHT

   SBL_MODE_GI keeps a store: the value of R on all surfaces of the scene, visible or not, one value for each cell. A
   cell is the part of a smooth surface that lies in one cube of a grid over the scene. Its light is measured at up to
   four points, where rays have met it: light from lamps as sensors measure it, and rays find the sky and other cells.
   These rays define a system of linear equations, whose solution contains all bounces.

   Light does not leak through walls or creep under them. The two sides of a wall have different cells, and the plane of
   a wall that stands on a floor cuts the cells of the floor. The sensors of a picture use the store only for the light
   that other surfaces reflect towards them. The store itself is visible only on surfaces with SBL_MATERIAL_NO_SENSORS
   and in SBL_CHANNEL_STORE.

   Cost: a picture takes 2 to 3 times as long as with direct light alone, including the store, and more if the picture
   is small (measured in several rooms, llvmpipe on two cores). The first work in this mode makes the store. It then
   serves all pictures and bakes of the scene, with any camera and size, until sbl_set_scene or sbl_set_mesh_transform
   discards it. A change of emission or lights takes half as long, see sbl_set_materials. sbl_save_store and
   sbl_load_store carry a store over to the next run. sbl_stats.seconds.bounce and sbl_stats.store tell its cost.

   Budget: sbl_scene_desc.max_bounce_cells limits the number of cells, and so their size. Time and memory grow with it.
   Raise it if a room is lit through a gap or a door, if geometry is small compared with the scene, or if light looks
   patchy; lower it for a quick preview. Grain of single pixels needs a smaller target_error.

   Accuracy at default settings, measured against an independent path tracer (relative root mean square error of R, in
   blocks of 4 x 4 pixels): 0.8 % in the Cornell box, 1.6 % in a staircase room with 130 emitting triangles, 4 % in a
   furnished room of 130,000 triangles with sky light from windows, and, in blocks of 8 x 8, 2.3 to 3 % in a dark room
   with a door ajar.

   Limits: an albedo above 0.98 reflects bounced light as 0.98, so that the sum of all bounces stays finite. A small and
   very bright surface, such as a ceiling just above a lamp, is found by rays at random, as in a path tracer, and leaves
   bright specks. Geometry of a draw callback neither blocks nor reflects light between other surfaces; towards sensors
   it reflects sbl_draw_view.light. Light that arrives at this geometry is measured as everywhere.


   ON LIGHTMAPS

   A lightmap is a picture of the scene's surfaces, spread out in a plane:

       chart     a part of a surface whose triangles touch each other both in the world and in the map
       gutter    the texels around a chart that show no surface. They repeat the chart's light, so that filtering does
                 not mix in black
       seam      an edge where two charts meet in the world, but not in the map

   Give meshes lightmap_texcoords that place all their triangles in one map without overlapping. Other tools call these
   coordinates a second UV set or a lightmap unwrap. Then call:

       sbl_lightmap_desc map = { 0 };
       map.width = map.height = 1024;
       if (sbl_bake_lightmap(context, &map) != SBL_SUCCESS) return 0;
       sbl_read_channel(context, SBL_CHANNEL_FINAL, light, 1024 * 1024 * 3);

   The map holds R. A renderer shows emission + albedo * R. The chapters on pictures and on the target error are true
   for lightmaps, with texels instead of pixels. Refinement, interpolation and filter never cross the border of a chart.

   Space between charts: leave at least four texels, and twice as many for each mip level that you sample. FINAL is
   continued into this space, half of it from either chart.

   Hidden texels get the light of their neighbours, because their own darkness would show beside the thing that hides
   them. A texel is hidden if something lies on it, closer than about half a texel. In SBL_MODE_GI a texel that no light
   reaches at all lies inside something and is hidden too. So are texels close to the border of a hidden area.

   Seams: where charts meet in the world and their normals agree, FINAL is changed as little as possible so that
   bilinear samples are equal on both sides. Light that differs by half or more is left as it is, because something
   stands between the sides. The triangles on both sides must share the edge from end to end.

   Detail: the light of a texel is that at its centre. A thin shadow, or the edge of a wide one, needs `supersample`,
   which measures several places per texel. A value of 2 takes about twice the time.

   Overlaps: if charts overlap or leave the map, a warning names the first place; SBL_CHANNEL_OVERLAP shows overlaps.

   Normal maps need light from several directions. If `directional` is set, the channels SH_0 to SH_3 hold this light as
   spherical harmonics, see sbl_channel. These four alone would give

       R(m) = 0.28209479 SH_0 + 0.32573501 (m_y SH_1 + m_z SH_2 + m_x SH_3)

   whose error is 19 % of R on average, over high and low lamps, windows and skies, for normals m that lean up to 45
   degrees. It is more accurate (7 %) to use them only for the change of R from the surface's own normal n. The change
   follows a lobe whose sharpness the harmonics give (Hazel, Geomerics 2015). For each colour channel:

       v = 0.16286750 (SH_3, SH_1, SH_2)    r = min(|v| / (0.28209479 SH_0), 1)    a = (1 - r) / (1 + r)
       f(m) = a + 2 (1 - a) (1 + r) ((1 + dot(m, v) / |v|) / 2)^(1 + 2 r)          R(m) = FINAL f(m) / f(n)

   If |v| or SH_0 is 0, R(m) = FINAL.

   (SH_3, SH_1, SH_2) is also the direction that most light comes from, for engines that store one colour and one
   direction. The predicted error is that of R. The harmonics are filtered, and their seams closed, as for R. They take
   8 % more time and 144 more bytes per texel.


   ON VERTEX LIGHT

   Light can be stored at vertices where lightmaps need too much memory, or where there is no second UV set. A renderer
   interpolates it as it interpolates vertex colours:

       sbl_vertices_desc bake = { 0 };
       bake.radiance = light;             // 3 floats per vertex, of all meshes, one mesh after the other
       bake.float_count = 3 * vertex_count;
       if (sbl_bake_vertices(context, &bake) != SBL_SUCCESS) return 0;

   R is measured at points spread over the triangles, never at vertices or edges, where R jumps and where walls meet.
   The light at the vertices is the least-squares fit: the values whose interpolation is closest to R at the points (L.
   Kavan, A. W. Bargteil and P.-P. Sloan, "Least Squares Vertex Baking", EGSR 2011). If triangles are large compared
   with the changes of light on them, the fit is more accurate than light that is measured at vertices or averaged
   around them. Beside a shadow the fit may make a vertex darker than all points around it, but not negative.

   Vertices of a mesh that have the same position, and normals that agree within 1 degree, share one value, so that
   texture seams do not show. A vertex without a normal uses the mean normal of its triangles.

   Points stuck inside geometry are left out. So are points that see little but back faces, because these lie inside
   something; but if most points of a mesh see back faces, all are kept, because whole rooms are modelled inside out. A
   vertex without points beside it gets the light of its neighbours, over at most 64 edges, or 0 if none has light. A
   vertex that belongs to no triangle, or only to triangles without area, gets 0. The fit takes about 200 bytes of
   memory and a few microseconds per triangle.


   ON PROBES

   A probe is the light at a point in the air, from all directions. It lights things that move through a baked scene.
   Give positions, or a grid of probes at the centres of equal boxes that fill the bounds of the scene:

       static sbl_probe probes[8 * 4 * 8];
       sbl_probes_desc desc = { 0 };
       desc.probes = probes;
       desc.grid[0] = desc.grid[2] = 8;
       desc.grid[1] = 4;
       if (sbl_bake_probes(context, &desc) != SBL_SUCCESS) return 0;

   A surface at the probe that faces n sends out emission + albedo * R(n); sbl_probe has the formula of R(n), and a
   coarser one for its ambient cube. Both contain all light, also from lamps, with shadows.

   Accuracy: light from surfaces and from the sky is measured along `rays` single rays, evenly over the sphere. Light
   from lamps is measured by sensors with 320 normals. For a point light the error is at most 0.4 % of the norm of its
   first four coefficients, and less for larger lamps. The noise of a half hidden lamp is 1.3 % with 4,096 rays and
   0.5 % with 16,384. R of a small lamp is slightly negative on the far side, where the cube gives 0.

   Validity: surfaces have two sides here, and a probe sees the light of both. Only back faces tell whether a probe is
   inside something: `valid` is 0 if more than a quarter of all directions end on back faces. This finds probes in
   closed objects, below the ground, and close behind a wall of one layer. If meshes are wound at random it tells
   nothing; use back_share for your own test. The light is correct for the probe's position in any case.

   Moving probes out of solids: if `move` is above 0, an invalid probe tries to go through the nearest back face of each
   octant of directions, from the nearest on, and an eighth of `move` beyond it, but never farther than `move` from the
   given position. It stays at the first valid position, or else where it was.

   Shadows of light from probes (as in DDGI) use distance and distance_squared. The sky is left out; where nothing but
   sky is visible, 0 means infinitely far.

   Geometry of a draw callback contributes to the light. The probe then sees by views (SBL_BACKEND_RASTER), whose error
   for a point light is 1.4 %. Rays still find sky, the distances, back_share and valid, without that geometry.


   ON MEMORY

   All memory comes from the allocator of sbl_context_desc, by default malloc and free. sbl_set_scene copies its input:
   the host may free arrays, textures and GL buffers afterwards.

   If memory runs out, the function returns SBL_ERROR_OUT_OF_MEMORY and the context stays usable. The scene or picture
   that was being made is dropped; an older scene stays. The memory of readings and probes does not grow with their
   number, because sbl_gather_readings works on 65,536 points at a time and sbl_bake_probes on 128.

   A finished picture stays readable until the next sbl_begin_picture, sbl_begin_lightmap or sbl_end, whatever else
   happens: also after sbl_set_scene, after meshes have moved, and during and after readings, vertices and probes. Only
   sbl_inspect_sensor needs the unchanged scene. A picture under way is dropped when its scene changes.


   ON TIME

   sbl_set_scene copies the scene and sends it to GL. The sbl_begin_... functions only check their descriptor. All other
   work is done by sbl_step, in small pieces: the bounding volume hierarchy (with the scene's first traced rays), the
   store of bounced light (with the scene's first work in SBL_MODE_GI), G-buffer, sensors, filter, anti-aliasing.

   Call sbl_step until it no longer returns SBL_UNFINISHED; examples/host_context.c does so in a frame loop.
   sbl_step(context, 0.005) returns after about 5 ms. GL work is sized by the speed measured so far, to at most about
   sbl_context_desc.longest_submission at a time, so that no driver's watchdog takes it for a hang. Two things cannot be
   divided: the smallest part of a submission (a few sensors, or one row of pixels), and the compilation of a shader
   program. Programs are compiled when they are first used, one per step, and are kept. With compile_ahead, sbl_create
   compiles nearly all of them (1.5 s on llvmpipe).

   The channels of a picture under way can be read after the first level, when the sensors of the first tiles have
   measured. They hold the best picture so far. Ask for a channel from the first step on: it costs nothing while there
   is nothing to read, and sbl_step then makes a better picture whenever the number of looks has grown by a quarter. The
   first request that comes later makes such a preview at once.

   In SBL_MODE_GI, filling the store takes 10 to 50 % of the time of the scene's first picture. A host that asks for a
   channel meanwhile gets a first picture of direct light alone, coarsely interpolated, after 1 to 6 % of the time, and
   one with all bounces as soon as the store is full. Hosts that do not ask pay nothing for it; finished pictures are
   the same.

   sbl_progress never decreases. For pictures and lightmaps it is the share of time that has passed if the rest takes as
   long as foreseen: it was off by up to 0.27 in measurements, most of all before the first sensors have measured.


   ON RESULTS AND MESSAGES

   Every function that can fail returns an sbl_result. The logger receives one line for each mistake, which says what
   went wrong, where, and what to change. Descriptors are checked completely, in release builds too: one call reports
   all mistakes (unless a canary is not 0), and a descriptor with a mistake changes nothing.

   Callbacks (draw, environment, allocator, logger, progress) may call the sbl_query_... functions of their context, and
   sbl_progress. Functions that change or step the context are refused there with SBL_ERROR_STATE. The progress callback
   may also read channels. sbl_write_function and sbl_read_function must not call functions of the context.


   ON THREADS

   There are no globals, so contexts are independent of each other. Two threads must not use one context at the same
   time.


   ON GL STATE

   Functions that use GL save the state that they change and restore it before they return, also on failure and cancel:
   framebuffers, program, vertex array, buffers, textures, samplers and images of the units that they use, viewport,
   scissor, depth, stencil, blend, cull, masks, clear values, polygon mode, pixel store, sRGB, clip distances, depth
   clamp, clip control, and so on. GL errors of the host are cleared.

   A conditional render, a transform feedback, and queries that count samples or primitives must not be active during a
   call. sbl.h cannot suspend them, and they would drop or count its own drawing.

   All functions that touch GL, including sbl_destroy, need the same current GL context as sbl_create. A headless
   context is made current by sbl.h itself, which then restores the host's EGL binding instead of its GL state. EGL
   cannot do that while a GLX context is current in the thread: calls are then refused with a message, and sbl_destroy
   does nothing. Either make no GLX context current during calls (glXMakeCurrent(display, None, NULL)), or set
   get_gl_function to glXGetProcAddress, so that sbl.h works in the GLX context.


   ON WINDOWS AND MACOS

   Without EGL, the host creates an OpenGL context of version 3.3 core or later (with WGL, GLFW, SDL, Qt), makes it
   current, and sets sbl_context_desc.get_gl_function to its loader. Size, pixel format and visibility of the window do
   not matter. OpenGL ES, and so ANGLE, is refused: it lacks clip distances and buffer textures.

   Windows: windows.h may be included before sbl.h, after it, or not at all. The loader may consist of wglGetProcAddress
   alone; sbl.h takes the functions of GL 1.1 from opengl32.dll. The loader works only while a context is current. After
   wglMakeCurrent:

       #include <windows.h>
       #define SBL_IMPLEMENTATION
       #include "sbl.h"

       static sbl_gl_function load(const char *name, void *user) {
           (void)user;
           return (sbl_gl_function)wglGetProcAddress(name);
       }

       sbl_context *start(void) {
           sbl_context_desc desc = { 0 };
           sbl_context *context;
           desc.get_gl_function = load;
           return sbl_create(&desc, &context) == SBL_SUCCESS ? context : NULL;
       }

   macOS: the newest GL is 4.1, which has neither compute shaders nor clip control. Fragment shaders then trace rays,
   with the same results. Contexts must be core and forward compatible, or they end at GL 2.1. With GLFW, anywhere:

       #include <GLFW/glfw3.h>
       #define SBL_IMPLEMENTATION
       #include "sbl.h"

       static sbl_gl_function load(const char *name, void *user) {
           (void)user;
           return glfwGetProcAddress(name);
       }

       int main(void) {
           sbl_context_desc desc = { 0 };
           sbl_context *context;
           GLFWwindow *window;
           if (!glfwInit()) return 1;
           glfwWindowHint(GLFW_CONTEXT_VERSION_MAJOR, 3);
           glfwWindowHint(GLFW_CONTEXT_VERSION_MINOR, 3);
           glfwWindowHint(GLFW_OPENGL_PROFILE, GLFW_OPENGL_CORE_PROFILE);
           glfwWindowHint(GLFW_OPENGL_FORWARD_COMPAT, GLFW_TRUE);
           window = glfwCreateWindow(640, 480, "sbl", NULL, NULL);
           if (!window) return 1;
           glfwMakeContextCurrent(window);
           desc.get_gl_function = load;
           if (sbl_create(&desc, &context) != SBL_SUCCESS) return 1;
           // sbl_set_scene and sbl_begin_picture; then in every frame sbl_step, and sbl_channel_texture to draw
           sbl_destroy(context);
           glfwTerminate();
           return 0;
       }

   Tested: mingw-w64 (64 and 32 bits), 64-bit programs in wine, GL 4.1 on Mesa. Not tested: Microsoft's compiler, a Mac.


   ON DETERMINISM

   The rotation of a sensor comes from a hash of its pixel and of the seed. The same input gives the same picture, bit
   for bit, on the same GL driver, whatever the batch size, the slices of sbl_step, and the number of repetitions.
   Other GL versions and drivers give the same picture up to rounding.

   sbl_gather_readings can repeat the light of the pixel (x, y). Give it the site of that pixel (sbl_sensor.site) as its
   site number y * width + x, with the picture's seed, and make both with the same `rays`, not 0. The result is equal to
   the bit if rays are traced, and equal up to rounding if views are drawn. The light of a probe depends on its number,
   its position, `rays` and the seed, and not on other probes.


   ON THE PAPER

   SBL_MODE_PAPER is the paper's method: one view of 135 degrees, equation 4, epsilon, the absolute threshold, and the
   Gaussian filter over one id. The texels of the views find emitters, and there are no other lights.

   All other modes differ from the paper:

       hemisphere      a sensor sees the whole hemisphere: by rays with a cosine distribution, or by the five views of a
                       hemicube, whose weights are the exact projected solid angles of their texels
       rotation        a sensor is rotated about its normal by a hash of its pixel
       lamps           their light is computed in closed form
       threshold       it is relative
       interpolation   it respects normals and planes as well as ids, and so does the filter
       looks           a sensor takes as many looks as the target error requires, up to 512
*/

#ifndef SBL_INCLUDED
#define SBL_INCLUDED

#include <stddef.h>
#include <stdint.h>

#define SBL_VERSION_MAJOR 0
#define SBL_VERSION_MINOR 2
#define SBL_VERSION_PATCH 0

/* SBL_STATIC makes every function private to the file that holds the implementation. SBL_API may be defined as the
   words that stand before each function instead, such as __declspec(dllexport). */
#ifndef SBL_API
  #if defined(SBL_STATIC) && defined(__GNUC__)
    #define SBL_API static __attribute__((unused))
  #elif defined(SBL_STATIC)
    #define SBL_API static
  #else
    #define SBL_API extern
  #endif
#endif

typedef struct sbl_context sbl_context;

/* >>results */

typedef enum sbl_result {
    SBL_SUCCESS = 0,
    SBL_UNFINISHED,              /* not an error: more work is left, or there is nothing to read yet; call sbl_step */
    SBL_CANCELLED,               /* the progress callback has cancelled the work */
    SBL_ERROR_INVALID_ARGUMENT,  /* a descriptor or parameter is out of range; the log names each field and value */
    SBL_ERROR_OUT_OF_MEMORY,     /* there is not enough host memory or GPU memory */
    SBL_ERROR_UNSUPPORTED,       /* the GL context, or this version of sbl.h, cannot do this */
    SBL_ERROR_STATE,             /* called in the wrong order: there is no scene or picture yet, nothing was begun, the
                                    scene has changed, or the call came from a callback */
    SBL_ERROR_GL,                /* GL reported an error, or a shader did not compile (a driver bug: see the log) */
    SBL_RESULT_COUNT
} sbl_result;

typedef enum sbl_log_level { SBL_LOG_ERROR, SBL_LOG_WARNING, SBL_LOG_INFO } sbl_log_level;

/* Every message belongs to one item, so that a host can select messages without reading their text. */
#define SBL_LOG_ITEMS(X)                                                                  \
    X(OK, "nothing to report")                                                            \
    X(INVALID_ARGUMENT, "a parameter is out of range")                                    \
    X(INVALID_CONTEXT_DESC, "a field of sbl_context_desc is out of range")                \
    X(INVALID_SCENE_DESC, "a field of sbl_scene_desc is out of range")                    \
    X(INVALID_MESH, "a mesh is not usable")                                               \
    X(INVALID_MATERIAL, "a material is not usable")                                       \
    X(INVALID_TEXTURE, "a texture is not usable")                                         \
    X(INVALID_LIGHT, "a light or the environment is not usable")                          \
    X(INVALID_PICTURE_DESC, "a field of sbl_picture_desc is out of range")                \
    X(INVALID_READINGS_DESC, "a field of sbl_readings_desc, or a site, is out of range")  \
    X(INVALID_LIGHTMAP_DESC, "a field of sbl_lightmap_desc is out of range")              \
    X(INVALID_PROBES_DESC, "a field of sbl_probes_desc is out of range")                  \
    X(INVALID_VERTICES_DESC, "a field of sbl_vertices_desc is out of range")              \
    X(WRONG_ORDER, "a function was called in the wrong order, or by a callback")          \
    X(OUT_OF_MEMORY, "memory could not be allocated")                                     \
    X(TOO_LARGE, "there is more than the GL context or the index range can hold")         \
    X(NO_GL, "there is no usable GL context")                                             \
    X(GL_FUNCTION_MISSING, "the GL loader did not find a function")                       \
    X(GL_ERROR, "GL reported an error")                                                   \
    X(SHADER_COMPILE, "a shader did not compile")                                         \
    X(SHADER_LINK, "a shader program did not link")                                       \
    X(FRAMEBUFFER, "a framebuffer is not complete")                                       \
    X(DRAWS_WRONG, "the driver's picture of a known triangle is wrong")                   \
    X(DEGENERATE_TRIANGLES, "triangles without area were left out")                       \
    X(NOTHING_VISIBLE, "the camera sees no surface, or a lightmap has none")              \
    X(OVERLAP, "triangles share texels of a lightmap")                                    \
    X(OUTSIDE, "triangles lie outside of a lightmap")                                     \
    X(NO_LIGHT, "nothing in the scene emits light")                                       \
    X(SCALE, "the scene is too small, too large or too far from the origin")              \
    X(INVALID_STORE, "saved light is damaged, or is no saved light")                      \
    X(OTHER_STORE, "saved light belongs to another scene, version or machine")            \
    X(COARSE_STORE, "saved light was made with fewer cells than max_bounce_cells")        \
    X(ALBEDO, "an albedo above 0.98 reflects bounced light as 0.98")                      \
    X(INFO, "information")

#define SBL__X(name, text) SBL_LOG_ITEM_##name,
typedef enum sbl_log_item { SBL_LOG_ITEMS(SBL__X) SBL_LOG_ITEM_COUNT } sbl_log_item;
#undef SBL__X

/* >>context types */

typedef void (*sbl_gl_function)(void);

typedef struct sbl_allocator {
    void *(*alloc)(size_t bytes, void *user);  /* returns NULL if memory runs out */
    void (*free)(void *pointer, void *user);   /* is never called with NULL */
    void *user;                                /* passed to both functions */
} sbl_allocator;

typedef struct sbl_logger {
    void (*log)(sbl_log_level level, sbl_log_item item, const char *message, void *user);  /* message: a line
                                                  without a line break, valid during the call */
    void *user;                                /* passed to log */
} sbl_logger;

/* Optional GL features. A bit in sbl_context_desc.disabled makes sbl.h act as if the driver lacked the feature. */
typedef enum sbl_capability {
    SBL_CAPABILITY_CLIP_CONTROL = 1 << 0,  /* GL 4.5 or ARB_clip_control: depth goes from 1 (near) to 0 (infinity), and
                                              shaders need not write it */
    SBL_CAPABILITY_COMPUTE = 1 << 1,       /* GL 4.3: compute shaders trace rays instead of fragment shaders; on
                                              llvmpipe this is 2 to 15 % faster, with results equal to the bit */
    SBL_CAPABILITY_ALL = (1 << 2) - 1
} sbl_capability;

typedef struct sbl_context_desc {
    uint32_t start_canary;    /* must stay 0; another value shows that the struct was not zeroed */
    sbl_gl_function (*get_gl_function)(const char *name, void *user);  /* loader of GL functions, such as
                                 eglGetProcAddress. Default: NULL, which creates a headless context (needs SBL_EGL) */
    void *gl_user;            /* passed to get_gl_function */
    sbl_allocator allocator;  /* where all memory comes from; set both functions or none. Default: malloc and free */
    sbl_logger logger;        /* receives all messages. Default: errors and warnings go to stderr, one line each, or
                                 nowhere if SBL_NO_STDIO is defined */
    uint32_t disabled;        /* sbl_capability bits of features that must not be used, for tests. Default: 0 */
    int sensor_texture_size;  /* width and height in texels of the texture of a batch's views, 256 to 16384, but at most
                                 what the driver supports. Changes pictures by float rounding only. Default: 2048 */
    int batch;                /* number of sensors that one draw call draws, at most as many as fit into the texture of
                                 views. The number never changes a picture. Default: as many as the time allows */
    float longest_submission; /* seconds that GL may work at a time, roughly. Default: 0.1 */
    int compile_ahead;        /* 1: sbl_create compiles all programs except those of inspections and of directional
                                 lightmaps. Default: 0, each program is compiled when it is first used */
    uint32_t end_canary;      /* must stay 0, as start_canary */
} sbl_context_desc;

typedef struct sbl_capabilities {
    int gl_major, gl_minor;   /* version of the GL context */
    uint32_t available;       /* sbl_capability bits of the features that the driver has */
    uint32_t used;            /* sbl_capability bits of the features that sbl.h uses: available, but not disabled */
    int max_texture_size;     /* largest width and height of a texture */
    int max_texture_buffer_size;  /* largest number of texels of a buffer texture. Larger scenes (3 per triangle, 2 per
                                 vertex, 5 per mesh) are read from 2D textures, 15 to 45 % slower on llvmpipe */
    char renderer[128];       /* GL_RENDERER */
    char version[128];        /* GL_VERSION */
} sbl_capabilities;

typedef struct sbl_programs {
    int count;                /* number of GL programs compiled so far */
    double compile_seconds;   /* seconds spent compiling them */
} sbl_programs;

typedef struct sbl_bounds {
    float lowest[3];          /* lowest world coordinates of the scene */
    float highest[3];         /* highest world coordinates of the scene */
} sbl_bounds;

typedef struct sbl_memory {
    size_t host_bytes;        /* bytes that the context holds of the host's memory now */
    size_t host_peak_bytes;   /* the highest host_bytes so far */
    size_t gpu_bytes;         /* bytes of the context's GL textures and buffers now; a driver may use more */
    size_t gpu_peak_bytes;    /* the highest gpu_bytes so far */
} sbl_memory;

/* >>scene types */

typedef enum sbl_type {
    SBL_FLOAT32 = 0,
    SBL_FLOAT16,
    SBL_UINT8_NORM,   /* 0 to 255 means 0 to 1; for colours and texture coordinates only */
    SBL_UINT16_NORM,  /* 0 to 65535 means 0 to 1 */
    SBL_INT8_NORM,    /* -127 to 127 means -1 to 1 */
    SBL_INT16_NORM,   /* -32767 to 32767 means -1 to 1 */
    SBL_UINT8,        /* whole numbers, for indices */
    SBL_UINT16,
    SBL_UINT32,
    SBL_TYPE_COUNT
} sbl_type;

/* One vertex attribute, or the indices. The stream is absent if both data and gl_buffer are 0. */
typedef struct sbl_stream {
    const void *data;    /* client memory; it is copied */
    uint32_t gl_buffer;  /* a GL buffer, used if data is NULL; it is read back once */
    size_t offset;       /* bytes from data, or from the start of the buffer, to the first element */
    size_t stride;       /* bytes from one element to the next. Default: tightly packed */
    sbl_type type;       /* type of each component. Default: SBL_FLOAT32 */
} sbl_stream;

/* A list of triangles. Winding matters only where the two sides of a surface differ (one-sided emission, lightmaps,
   vertices, back faces): seen from the front, the corners run counter-clockwise. */
typedef struct sbl_mesh {
    sbl_stream positions;  /* 3 components; required */
    sbl_stream normals;    /* 3 components in object space, of any length. Default: triangles are flat */
    sbl_stream texcoords;  /* 2 components; v = 0 is the first row of the texture. Default: 0 0 */
    sbl_stream lightmap_texcoords;  /* 2 components, the place in a lightmap: (0, 0) is the first corner of the first
                              row, (1, 1) the last corner of the last row. Default: the mesh is in no lightmap */
    sbl_stream colors;     /* 4 components, linear rgb and alpha, times the material's albedo. Default: 1 1 1 1 */
    sbl_stream indices;    /* 3 per triangle: SBL_UINT8, SBL_UINT16 or SBL_UINT32. Default: 0 1 2, 3 4 5, ... */
    int vertex_count;      /* number of vertices in each of the attributes */
    int index_count;       /* number of indices, a multiple of 3; ignored if there are no indices */
    float transform[16];   /* object to world, column-major, affine. Default (all zero): identity */
    int material;          /* index into sbl_scene_desc.materials */
    uint32_t id;           /* surfaces with the same id may be filtered together. Default: the mesh's index + 1 */
} sbl_mesh;

typedef enum sbl_material_flag {
    SBL_MATERIAL_ONE_SIDED_EMISSION = 1 << 0,  /* the back does not emit */
    SBL_MATERIAL_HIDDEN_FROM_CAMERA = 1 << 1,  /* the camera does not see the surface */
    SBL_MATERIAL_HIDDEN_FROM_SENSORS = 1 << 2, /* the surface neither sheds light on others nor casts shadows */
    SBL_MATERIAL_NO_SENSORS = 1 << 3,  /* SBL_MODE_GI: no sensors stand on the surface; it shows the stored light,
                                          smoothed. For fine or moving things. Casts shadows and reflects as usual */
    SBL_MATERIAL_FLAGS_ALL = (1 << 4) - 1
} sbl_material_flag;

/* A material has no defaults: all zero is a black, solid surface without emission and textures. */
typedef struct sbl_material {
    float albedo[3];       /* linear share of light that is reflected, 0 to 1 each */
    float emission[3];     /* emitted radiance, 0 or more */
    int albedo_texture;    /* number of the texture that multiplies albedo, counted from 1; 0: none */
    int emission_texture;  /* number of the texture that multiplies emission, counted from 1; 0: none */
    float alpha_cutoff;    /* the surface has a hole where its alpha (alpha of the albedo texture times alpha of the
                              vertex colour) is below this value; 0: no holes */
    uint32_t flags;        /* sbl_material_flag bits */
} sbl_material;

typedef enum sbl_pixel_format {
    SBL_PIXELS_SRGB8 = 0,  /* 8 bits each; colour is encoded as sRGB, alpha is linear */
    SBL_PIXELS_LINEAR8,    /* 8 bits each; 0 to 255 means 0 to 1 */
    SBL_PIXELS_FLOAT,      /* linear 32-bit floats; they are stored with 16 bits */
    SBL_PIXEL_FORMAT_COUNT
} sbl_pixel_format;

typedef enum sbl_wrap { SBL_WRAP_REPEAT = 0, SBL_WRAP_CLAMP, SBL_WRAP_COUNT } sbl_wrap;

/* A texture. It is filtered bilinearly, without mip maps. */
typedef struct sbl_texture {
    const void *pixels;       /* client memory; it is copied */
    uint32_t gl_texture;      /* a GL_TEXTURE_2D, used if pixels is NULL; level 0 is copied as a shader samples it */
    sbl_pixel_format format;  /* format of pixels. The copy of gl_texture is stored as 8-bit sRGB for SBL_PIXELS_SRGB8,
                                 otherwise as 16-bit floats. Default: SBL_PIXELS_SRGB8 */
    int width, height;        /* pixels; leave 0 for gl_texture, whose size is read from GL */
    int channels;             /* 1: grey, 2: grey and alpha, 3: rgb, 4: rgba. Default: 4 */
    size_t stride;            /* bytes from one row to the next. Default: tightly packed */
    sbl_wrap wrap;            /* what texture coordinates outside of 0 to 1 show. Default: SBL_WRAP_REPEAT */
} sbl_texture;

typedef enum sbl_light_kind {
    SBL_LIGHT_POINT = 0,
    SBL_LIGHT_SPOT,
    SBL_LIGHT_DIRECTIONAL,
    SBL_LIGHT_KIND_COUNT
} sbl_light_kind;

/* A light that is not a surface: camera and sensors do not see it, and it casts no shadow. Kinds and units follow
   glTF's KHR_lights_punctual: if radiance is in nits and lengths are in metres, intensities are in candela (point,
   spot) and in lux (directional). Unlike in glTF, cones are full angles in degrees, and there is no maximum range. */
typedef struct sbl_light {
    sbl_light_kind kind;      /* Default: SBL_LIGHT_POINT */
    float intensity[3];       /* point, spot: radiance times area; the irradiance at distance d is intensity / d^2.
                                 Directional: the irradiance. Both are those of a surface that faces the light */
    float position[3];        /* point, spot: world position */
    float direction[3];       /* spot, directional: the direction in which the light travels, of any length but 0 */
    float radius;             /* point, spot: radius of a sphere of constant radiance intensity / (pi radius^2), which
                                 makes shadows soft; 0: a point */
    float angle;              /* directional: angular diameter, 0 (a point) to 180 degrees; the sun has 0.53 */
    float cone;               /* spot: full angle of the cone that receives light, degrees, up to 180. Default: 90 */
    float inner_cone;         /* spot: full angle of the cone that receives all of the light, degrees, 0 to cone. At an
                                 angle a from the axis between the cones, the light is multiplied by s * s, where s =
                                 (cos a - cos(cone / 2)) / (cos(inner_cone / 2) - cos(cone / 2)). Default: 0 */
} sbl_light;

/* Light from far away, given as a picture or as a function. It adds to the constant sky. In SBL_MODE_PAPER there is
   neither an environment nor any sbl_light.
   The direction d is at u = 0.5 + atan2(d . z, d . x) / (2 pi), v = acos(d . up) / pi in the picture. x and z are the
   world's axes if up is +y; otherwise they are turned with up along the shortest arc. (0, 0) is the picture's first
   corner, so the upper edge of the picture is straight up everywhere. */
typedef struct sbl_environment {
    sbl_texture picture;      /* equirectangular picture of any pixel format, with finite values that are not negative;
                                 gl_texture and wrap are not allowed. There is no environment if its width is 0
                                 and radiance is NULL */
    void (*radiance)(const float direction[3], float radiance[3], void *user);  /* used instead of pixels: gets the
                                 radiance from a unit direction in the world. sbl_set_scene calls it for the centre of
                                 each texel of a picture of picture.width x picture.height, by default 512 x 256.
                                 rotation and up do not change the direction that it gets */
    void *user;               /* passed to radiance */
    float scale;              /* multiplies the light of the environment. Default: 1. Negative: 0, no light */
    float rotation;           /* degrees; rotates the picture about `up`, counter-clockwise seen from above */
    float up[3];              /* world direction of the picture's upper edge. Default: 0 1 0 */
} sbl_environment;

/* >>draw callback types: geometry that only the host can draw */

typedef enum sbl_view_kind { SBL_VIEW_CAMERA = 0, SBL_VIEW_SENSOR } sbl_view_kind;

/* What the host's draw callback receives. Framebuffer, viewport, scissor and depth test are set and must stay as they
   are. The callback may change all other GL state: sbl.h sets its own state again afterwards, and restores the host's
   state at the end.

   Outputs of the fragment shader, SBL_VIEW_SENSOR:
       location 0  vec4: rgb = radiance towards the sensor times radiance_scale;
                         a = gl_FrontFacing ? 1.0 / gl_FragCoord.w : -1.0 / gl_FragCoord.w
   Outputs, SBL_VIEW_CAMERA:
       location 0  vec4: world position, a = 0
       location 1  vec4: unit shading normal towards the camera, a = 0
       location 2  vec4: unit geometric normal towards the camera, a = 0
       location 3  vec4: albedo, a = 1
       location 4  vec4: emission, a = 0
       location 5  uint: id, not 0
   gl_Position = world_to_clip * vec4(world position, 1). Depth is reversed: nearer is greater.

   Cost: the callback is called once for each view of each sensor, and a hemicube has five views. Meshes are drawn for
   many sensors in one call. */
typedef struct sbl_draw_view {
    sbl_view_kind kind;       /* whose view is drawn: the camera's or a sensor's */
    int viewport[4];          /* x, y, width, height in the current framebuffer; the scissor is the same */
    float world_to_view[16];  /* rigid; view space looks along -z, and y is up */
    float view_to_clip[16];   /* projection with reversed, infinite depth */
    float world_to_clip[16];  /* view_to_clip * world_to_view */
    float eye[3];             /* world position of the sensor or camera */
    float radiance_scale;     /* factor that keeps bright lamps inside the range of the texels */
    float depth_scale;        /* factor of the depth, see write_depth */
    int write_depth;          /* 1: the fragment shader must write gl_FragDepth = gl_FragCoord.w * depth_scale */
    float epsilon;            /* the paper's ambient factor; 0 in SBL_MODE_DIRECT and SBL_MODE_GI */
    float light[6][3];        /* SBL_VIEW_SENSOR: ambient cube as in sbl_probe.cube (McTaggart 2004, "Half-Life 2 /
                                 Valve Source Shading"); a surface radiates emission + albedo * R(its normal).
                                 SBL_MODE_GI: the light, with all bounces, that meshes, lights and sky send to
                                 draw_bounds. Other modes: epsilon */
    int sensor, face;         /* SBL_VIEW_SENSOR: number of the sensor within its level, and number of the view; view 0
                                 looks along the normal */
} sbl_draw_view;

typedef void (*sbl_draw_function)(const sbl_draw_view *view, void *user);

typedef struct sbl_scene_desc {
    uint32_t start_canary;     /* must stay 0 */
    const sbl_mesh *meshes;
    int mesh_count;
    const sbl_material *materials;
    int material_count;
    const sbl_texture *textures;
    int texture_count;
    const sbl_light *lights;   /* lights besides the surfaces that emit */
    int light_count;
    float sky[3];              /* constant radiance of all directions in which no surface is hit */
    sbl_environment environment;  /* light from far away, in addition to sky */
    sbl_draw_function draw;    /* draws geometry that only the host can draw; see sbl_draw_view. Default: none */
    void *draw_user;           /* passed to draw */
    float draw_bounds[2][3];   /* world bounds (lowest corner, highest corner) of that geometry; required with draw */
    float draw_max_radiance;   /* the highest radiance that draw writes, so that texels do not overflow. Default: 1 */
    int max_bounce_cells;      /* maximum number of cells that store bounced light in SBL_MODE_GI, 1024 to 1048576. A
                                  cell takes about 4 KB of host memory while the store is made, 2 KB from then on until
                                  sbl_end, and 100 bytes of GPU memory. Default: 49152 */
    uint32_t end_canary;       /* must stay 0 */
} sbl_scene_desc;

/* Callbacks of sbl_save_store and sbl_load_store; see there. */
typedef size_t (*sbl_write_function)(const void *data, size_t bytes, void *user);
typedef size_t (*sbl_read_function)(void *data, size_t bytes, void *user);

/* >>options */

typedef enum sbl_mode {
    SBL_MODE_DEFAULT = 0,  /* the default, see sbl_options.mode */
    SBL_MODE_AMBIENT,      /* emitters, lights and sky; every other surface has the radiance epsilon * albedo, which is
                              the paper's substitute for bounced light */
    SBL_MODE_DIRECT,       /* emitters, lights and sky only */
    SBL_MODE_PAPER,        /* exactly the paper's method, see ON THE PAPER */
    SBL_MODE_GI,           /* all light: emitters, lights, sky, and the light that surfaces reflect, with all bounces */
    SBL_MODE_COUNT
} sbl_mode;

typedef enum sbl_preset { SBL_PRESET_DEFAULT = 0, SBL_PRESET_DRAFT, SBL_PRESET_HIGH, SBL_PRESET_COUNT } sbl_preset;

/* View transforms, which map radiance from 0 to infinity to what a screen can show, 0 to 1. */
typedef enum sbl_tone {
    SBL_TONE_NONE = 0,  /* SBL_CHANNEL_DISPLAY is not made */
    SBL_TONE_CLIP,      /* everything above 1 is 1 */
    SBL_TONE_NEUTRAL,   /* PBR Neutral (Khronos Group 2024): keeps colours, compresses only highlights; radiance below
                           0.08 gets darker */
    SBL_TONE_AGX,       /* AgX (Sobotka 2022): a filmic curve over 16 stops; bright colours fade to white */
    SBL_TONE_COUNT
} sbl_tone;

typedef enum sbl_sensor_kind {
    SBL_SENSOR_DEFAULT = 0,  /* the default, see sbl_picture_desc.sensor_kind */
    SBL_SENSOR_HEMICUBE,     /* five views, which cover the whole hemisphere */
    SBL_SENSOR_SINGLE,       /* the paper's single view, sensor_fov wide; beyond it the sensor sees only lamps */
    SBL_SENSOR_KIND_COUNT
} sbl_sensor_kind;

/* How sensors collect light. Both ways give the same light up to noise. */
typedef enum sbl_backend {
    SBL_BACKEND_AUTO = 0,    /* RASTER in SBL_MODE_PAPER, with a draw callback or SBL_SENSOR_SINGLE; else TRACE */
    SBL_BACKEND_RASTER,      /* draws views, as in the paper; the cost grows with the number of triangles. Rays towards
                                lamps meet only meshes; views show where the geometry of a draw callback blocks a lamp,
                                and the light that it emits */
    SBL_BACKEND_TRACE,       /* traces rays through a bounding volume hierarchy; the cost grows with the logarithm of
                                the number of triangles. The noise of sensors is known, so refinement follows light and
                                not noise. Not in SBL_MODE_PAPER, nor with a draw callback */
    SBL_BACKEND_COUNT
} sbl_backend;

/* The options that all front ends share. Three numbers are the values of the presets draft / default / high. */
typedef struct sbl_options {
    sbl_mode mode;             /* light to compute; SBL_MODE_PAPER: only pictures and readings. Default: SBL_MODE_GI */
    sbl_preset preset;         /* selects the defaults of other fields. Default: SBL_PRESET_DEFAULT */
    sbl_backend backend;       /* how sensors collect light. Default: SBL_BACKEND_AUTO */
    int rays;                  /* number of rays that a sensor traces over its hemisphere, 1 to 4096; for vertices that
                                  of each point; for probes the number over the whole sphere, 64 to 65536.
                                  Default of pictures and lightmaps: as many as the target error requires. If set, a
                                  sensor takes exactly one look of that many rays.
                                  Default of readings: 64 / 256 / 1024.
                                  Default of vertices: 16 / 64 / 256.
                                  Default of probes: 1024 / 4096 / 16384.
                                  Readings and vertices: if set, exactly this many rays are traced. Otherwise few are
                                  traced when only lamps emit, because they are then needed only for hit_share,
                                  back_share, hit_mean, hit_min and valid.
                                  Rays towards lamps come in addition: at most as many again, and for probes a 64th of
                                  rays, but 32 to 256, for each of a probe's normals */
    int sensor_size;           /* number of texels across a view of a rasterised sensor, 4 to 512.
                                  Default: 32 / 64 / 128. Default of probes: 8 / 16 / 32 */
    float epsilon;             /* ambient factor: a surface that does not emit has the radiance epsilon * albedo.
                                  Default in SBL_MODE_AMBIENT and SBL_MODE_PAPER: 0.02. Negative: no ambient light.
                                  SBL_MODE_DIRECT and SBL_MODE_GI ignore the field */
    uint32_t seed;             /* selects the rotations of the sensors, and so the noise. Default: 0 */
    int (*progress)(float done, void *user);  /* called between two pieces of work; done goes from 0 to 1. A nonzero
                                  result cancels the work. Default: NULL, no call */
    void *progress_user;       /* passed to progress */
} sbl_options;

/* >>picture types */

/* Three numbers are the values of the presets draft / default / high. */
typedef struct sbl_picture_desc {
    uint32_t start_canary;     /* must stay 0 */
    int width, height;         /* pixels, 1 to 16384. Default: 640 x 480, if both are 0 */
    float world_to_view[16];   /* rigid, see sbl_look_at. Default (all zero): shows the whole scene from the front */
    float view_to_clip[16];    /* perspective projection, or an orthographic one, which also sees what is behind the
                                  camera; near and far planes are ignored. Default (all zero): 40 degrees vertically */
    sbl_options options;       /* mode, preset, back end, rays, seed, progress: see sbl_options */
    sbl_sensor_kind sensor_kind;  /* the views of a rasterised sensor. Default: SBL_SENSOR_HEMICUBE. Default in
                                  SBL_MODE_PAPER: SBL_SENSOR_SINGLE */
    float sensor_fov;          /* field of view of SBL_SENSOR_SINGLE, 1 to 179 degrees. Default: 135 */
    float target_error;        /* accepted root mean square error of R over the visible pixels, as a share of the mean R
                                  there, 0 to 1; see ON THE TARGET ERROR. If not set, a sensor takes at most 512 / 512 /
                                  1024 rays. Default: 0.05 / 0.015 / 0.0075. Default in SBL_MODE_PAPER: threshold
                                  decides */
    int tile;                  /* pixels between sensors of the first level, 1 (every pixel) to 1024. Default: 16 */
    float threshold;           /* if set, tiles are refined where neighbouring sensors differ by more than this share of
                                  their mean, instead of where the target error requires it; in SBL_MODE_PAPER the
                                  threshold is a radiance. Default: the target error decides.
                                  Default in SBL_MODE_PAPER: 0.05. Negative: 0, every difference refines */
    float facet_limit;         /* triangles whose least height on the screen is at most this many pixels are lit by
                                  their true normals, because the facets that shading normals hide are too small to be
                                  seen. From twice this height on, shading normals are used; in between, a mixture.
                                  Default: 2. Negative: shading normals on all triangles */
    int filter_radius;         /* radius of the Gaussian filter, up to 32 pixels. Default: 2. Negative: no filter */
    int samples;               /* anti-aliasing samples per pixel of SBL_CHANNEL_FINAL, 1 to 64. Default: 1 / 4 / 16 */
    sbl_tone tone;             /* how SBL_CHANNEL_DISPLAY is made. Default: SBL_TONE_NONE */
    float exposure;            /* stops, -100 to 100: each doubles the brightness of SBL_CHANNEL_DISPLAY. Default: 0 */
    int auto_exposure;         /* 1: measures the picture and adds the stops that suit it, see ON SCREENS. Default: 0 */
    uint32_t end_canary;       /* must stay 0 */
} sbl_picture_desc;

/* The channels of a picture or lightmap, with their number of floats per pixel. Where the camera sees no surface, all
   channels are 0 except FINAL, which shows the sky. FINAL of a picture under way is not anti-aliased. SH_0 to SH_3 are
   the radiance over a texel's hemisphere in the first four spherical harmonics of sbl_probe, continued into the gutter
   as FINAL is; they are 0 unless a directional lightmap is finished (see ON LIGHTMAPS). */
typedef enum sbl_channel {
    SBL_CHANNEL_FINAL = 0,  /* 3: emission + albedo * R, anti-aliased */
    SBL_CHANNEL_RADIANCE,   /* 3: R at pixel centres, filtered */
    SBL_CHANNEL_ALBEDO,     /* 3: linear albedo */
    SBL_CHANNEL_NORMAL,     /* 3: unit normal in world space, towards the camera */
    SBL_CHANNEL_POSITION,   /* 3: world position */
    SBL_CHANNEL_ID,         /* 1: sbl_mesh.id */
    SBL_CHANNEL_DEPTH,      /* 1: distance along the view axis */
    SBL_CHANNEL_SENSORS,    /* 1: 0 if the pixel was interpolated, else 1 + the level at which its sensor was placed */
    SBL_CHANNEL_STORE,      /* 3: R as stored for each cell in SBL_MODE_GI; 0 in other modes */
    SBL_CHANNEL_ERROR,      /* 1: predicted standard error of the luminance of R, see ON THE TARGET ERROR */
    SBL_CHANNEL_OVERLAP,    /* 1: lightmaps: number of other triangles at the texel's centre; 0 in pictures */
    SBL_CHANNEL_SH_0,       /* 3: directional lightmaps: harmonic Y_0 */
    SBL_CHANNEL_SH_1,       /* 3: directional lightmaps: harmonic Y_1 */
    SBL_CHANNEL_SH_2,       /* 3: directional lightmaps: harmonic Y_2 */
    SBL_CHANNEL_SH_3,       /* 3: directional lightmaps: harmonic Y_3 */
    SBL_CHANNEL_DISPLAY,    /* 3: what a screen shows, linear, 0 to 1: FINAL, but every anti-aliasing sample is exposed
                               and tone-mapped before the samples are averaged; 0 without a tone, and in lightmaps */
    SBL_CHANNEL_COUNT
} sbl_channel;

#define SBL_MAX_LEVELS 16

/* Counts and seconds of the work that was begun last. Fields that do not belong to that work are 0. */
typedef struct sbl_stats {
    sbl_mode mode;
    sbl_backend backend;          /* SBL_BACKEND_RASTER or SBL_BACKEND_TRACE */
    struct {
        int triangles;            /* number of triangles in the scene, without degenerate ones */
        int lamps;                /* number of emitting triangles, lights and bright texels of the sky */
        double bvh_seconds;       /* seconds spent on building the bounding volume hierarchy, once per scene; they are
                                     part of seconds.surface of the scene's first traced work */
        size_t bvh_bytes;         /* GPU memory of the hierarchy in bytes */
    } scene;
    struct {                      /* the store of bounced light, SBL_MODE_GI */
        int cells;                /* number of cells in the store */
        int64_t rays;             /* rays between surfaces and of the store's sensors, if this work made the store */
    } store;
    struct {
        int64_t count;            /* number of sensors, one for each point at which light was measured */
        int64_t invalid;          /* number of sensors that are stuck inside geometry, and in lightmaps also those of
                                     hidden texels; the light of their neighbours is used instead */
        int64_t views;            /* number of views drawn, over all looks */
        int64_t texels;           /* number of texels in these views */
        int64_t rays;             /* number of rays traced over the hemispheres; rays towards lamps are not counted */
        int readbacks;            /* number of transfers from GPU to host */
        double microseconds;      /* seconds.total divided by count, as in the paper, in microseconds */
    } sensors;
    struct {                      /* the picture or lightmap */
        int width, height;        /* pixels */
        int visible_pixels;       /* number of pixels that show a surface */
        float target_error;       /* the target error that applied; 0 in SBL_MODE_PAPER */
        float expected_error;     /* the error predicted so far, as a share of the mean R; 0 before the first level is
                                     done */
        float exposure;           /* stops applied to SBL_CHANNEL_DISPLAY, including those that auto_exposure chose */
        float stored_error;       /* the part of expected_error that sensors cannot reduce: the root mean square error
                                     of stored light, as a share of the mean R */
        int level_count;          /* number of entries in levels */
        struct { int tile; int64_t sensors; } levels[SBL_MAX_LEVELS];  /* tile size in pixels and number of sensors */
    } picture;
    struct {
        int seams;                /* number of edges at which charts meet in the world */
        float seam_before, seam_after;  /* largest difference of the luminance of R across seams, before and after they
                                     were made equal, as a share of the mean */
    } lightmap;
    struct {
        double scene;             /* time that sbl_set_scene took */
        double surface;           /* time before the first sensor: hierarchy, lamps, and the G-buffer */
        double bounce;            /* time spent on the store of bounced light */
        double gather;            /* time spent on sensors */
        double refine;            /* time spent on tiles, errors and interpolation, and on fitting light at vertices */
        double filter;            /* time spent on the filter */
        double resolve;           /* time spent on previews, anti-aliasing, gutters and seams */
        double total;             /* time since the work was begun, as far as it was spent in sbl.h */
    } seconds;
} sbl_stats;

/* >>readings types */

/* A point at which light is wanted. */
typedef struct sbl_site {
    float position[3];          /* world position */
    float normal[3];            /* middle of the hemisphere that light comes from; any length but 0 */
    float geometric_normal[3];  /* side of the surface to which the sensor is moved. Default (all zero): normal */
    float offset;               /* world distance that the sensor moves. Default: what rounding requires. Negative: 0 */
} sbl_site;

/* The light at a site. */
typedef struct sbl_reading {
    float radiance[3];  /* R */
    float noise;        /* standard error of the luminance of R; 0 if it is unknown */
    float hit_share;    /* cosine-weighted share of the hemisphere that surfaces cover; the rest is sky */
    float back_share;   /* share of hit_share in which back faces are seen */
    float hit_mean;     /* mean world distance to the surfaces seen; 0 if there are none */
    float hit_min;      /* least world distance to the surfaces seen; 0 if there are none */
    int valid;          /* 0: a surface is so close that the sensor is stuck in it, or the light overflows. A point
                           inside a closed object, away from its surfaces, is valid; back_share tells that */
} sbl_reading;

/* Fields with the same name as in sbl_picture_desc have the same meaning. */
typedef struct sbl_readings_desc {
    uint32_t start_canary;     /* must stay 0 */
    const sbl_site *sites;     /* the points; not copied, must stay valid until the readings are done */
    sbl_reading *readings;     /* receives one reading per site, in the order of sites; must stay valid likewise */
    int site_count;            /* number of sites, 0 or more */
    sbl_options options;       /* see sbl_options; site number i is rotated as pixel number i of a picture */
    sbl_sensor_kind sensor_kind;  /* the views of a rasterised sensor. Default: as in sbl_picture_desc */
    float sensor_fov;          /* field of view of SBL_SENSOR_SINGLE. Default: as in sbl_picture_desc */
    uint32_t end_canary;       /* must stay 0 */
} sbl_readings_desc;

/* >>lightmap types */

/* A picture of the surfaces of all meshes that have lightmap_texcoords, spread out as these coordinates say. Fields
   with the same name as in sbl_picture_desc have the same meaning, with texels instead of pixels. Three numbers are
   the values of the presets draft / default / high.

   If any surface touches the square of a texel, the texel shows the point of a surface that is nearest to its centre.
   Light is measured on the front of a surface: the side that its normals point to, or without normals the side from
   which its corners run counter-clockwise.

   Unlike in a picture, FINAL is R, continued into the gutter; ID is 1 + the number of the chart; DEPTH is 0. */
typedef struct sbl_lightmap_desc {
    uint32_t start_canary;     /* must stay 0 */
    int width, height;         /* texels, 1 to 16384. Default: 512 x 512 */
    const int *meshes;         /* indices of the meshes that are baked, all with lightmap_texcoords; read when the
                                  lightmap begins. Default: all meshes that have them */
    int mesh_count;            /* number of entries in meshes */
    int gutter;                /* width of the border around charts into which FINAL is continued, up to 16384 texels,
                                  see ON LIGHTMAPS. Default: 16. Negative: no gutter */
    int seams;                 /* 0: light is made equal across seams, see ON LIGHTMAPS. Default: 0. Negative, or no
                                  gutter: seams stay */
    int directional;           /* 1: also store the direction of the light, in channels SH_0 to SH_3 */
    int supersample;           /* number of places across a texel at which light is measured, 1 to 8; FINAL, RADIANCE
                                  and SH are their means, other channels show the place nearest to the centre. width and
                                  height times this are at most 16384. Default: 1 */
    sbl_options options;       /* see sbl_options */
    float target_error;        /* accepted root mean square error of R over the texels, as in sbl_picture_desc. If not
                                  set, a sensor takes at most 512 / 1024 / 2048 rays. Default: 0.02 / 0.005 / 0.0025 */
    int tile;                  /* texels between sensors of the first level. Default: as in sbl_picture_desc */
    float threshold;           /* refines where sensors differ by more. Default: as in sbl_picture_desc */
    int filter_radius;         /* radius of the filter in texels. Default: as in sbl_picture_desc */
    uint32_t end_canary;       /* must stay 0 */
} sbl_lightmap_desc;

/* >>probe types */

/* The light at a point in the air.
   sh is the arriving radiance in real orthonormal spherical harmonics: sh[i] is the integral over the sphere of
   L(w) Y_i(w), where w = (x, y, z) is the unit vector towards the light's origin, for i = 0 to 8:

       Y_0     0.28209479  (1 / sqrt(4 pi))               Y_1 2 3   0.48860251 (sqrt(3 / 4 pi)) times y, z, x
       Y_4 5   1.09254843  (sqrt(15 / 4 pi)) x y, y z     Y_6       0.31539157 (sqrt(5 / 16 pi)) (3 z^2 - 1)
       Y_7     1.09254843  x z                            Y_8       0.54627422 (sqrt(15 / 16 pi)) (x^2 - y^2)

   R(n) = irradiance / pi = the sum of A_i sh[i] Y_i(n), where A_0 = 1, A_1 to A_3 = 2/3, A_4 to A_8 = 1/4. */
typedef struct sbl_probe {
    float position[3];         /* world position: the one that was asked for, or the one that the probe was moved to */
    float sh[9][3];            /* spherical harmonics of the radiance, rgb each */
    float cube[6][3];          /* ambient cube: R on a surface that faces +x, -x, +y, -y, +z, -z. R(n) is about the mean
                                  of the three sides that n turns to, weighted by the squares of n's components */
    float sky;                 /* share of all directions in which no surface is seen, 0 to 1 */
    float distance[8];         /* mean world distance to the surfaces seen towards each octant (number: bit 0 is x > 0,
                                  bit 1 is y > 0, bit 2 is z > 0), with the weights max(0, cosine to the octant's
                                  middle); 0 if no surface is seen */
    float distance_squared[8]; /* mean of the square of the distance, with the same weights */
    float back_share;          /* share of the directions with surfaces in which back faces are seen */
    int valid;                 /* 0: the probe is inside something, or its light overflows */
} sbl_probe;

/* Fields with the same name as in sbl_picture_desc have the same meaning. */
typedef struct sbl_probes_desc {
    uint32_t start_canary;     /* must stay 0 */
    const float *positions;    /* 3 floats per probe, world; not copied, must stay valid until the probes are done.
                                  Default: NULL, a grid */
    sbl_probe *probes;         /* receives one probe per position, in the same order; must stay valid likewise */
    int probe_count;           /* number of probes, 0 or more. Default: number of points of the grid */
    int grid[3];               /* if positions is NULL: number of probes along x, y and z. x runs fastest, then y. The
                                  probes are at the centres of equal boxes that fill the space from lowest to highest */
    float lowest[3], highest[3];  /* world corners of the grid. Default (all zero): the bounds of the scene */
    float move;                /* greatest world distance to move a probe out of something, see ON PROBES. Default: 0 */
    sbl_options options;       /* see sbl_options; the seed rotates the rays */
    uint32_t end_canary;       /* must stay 0 */
} sbl_probes_desc;

/* >>vertex types */

/* Light at the vertices of meshes, on the front of surfaces as in sbl_lightmap_desc; see ON VERTEX LIGHT. Three numbers
   are the values of the presets draft / default / high. */
typedef struct sbl_vertices_desc {
    uint32_t start_canary;     /* must stay 0 */
    const int *meshes;         /* indices of the meshes, in the order in which radiance holds their vertices; read when
                                  the work begins. Default: all meshes of the scene */
    int mesh_count;            /* number of entries in meshes */
    float *radiance;           /* receives R, 3 floats for each of the vertex_count vertices of a mesh, one mesh after
                                  the other; never negative. Must stay valid until the work is done */
    size_t float_count;        /* number of floats that radiance has room for */
    int samples;               /* number of points on a triangle that has the mean area of its mesh, 1 to 1024. Others
                                  have points in proportion to their area, at least 4 and at most 8 times samples.
                                  Default: 4 / 8 / 16 */
    int average;               /* 1: each vertex gets the mean of the points around it instead of the least-squares fit.
                                  This is smoother, and wrong where light changes within large triangles. Default: 0 */
    float smoothing;           /* weight of the rule that the slope of the light agrees on triangles that share an edge,
                                  relative to the weight of the points; light that is linear stays as it is. Default:
                                  0.02. Negative: 0, no rule */
    sbl_options options;       /* see sbl_options; rays are those of one point */
    uint32_t end_canary;       /* must stay 0 */
} sbl_vertices_desc;

/* >>inspection types */

/* One view of a rasterised sensor. Texel (i, j) of the view looks along forward + right * x + up * y, where
   x = x0 + (x1 - x0) * (i + 0.5) / width and y = y0 + (y1 - y0) * (j + 0.5) / height. */
typedef struct sbl_sensor_view {
    int rect[4];              /* x, y, width, height in the sheet; y counts from the first row */
    float right[3], up[3], forward[3];  /* unit vectors in the world */
    float x0, x1, y0, y1;     /* extent of the view at distance 1 */
} sbl_sensor_view;

/* What sensors send rays to. */
typedef enum sbl_lamp_kind {
    SBL_LAMP_TRIANGLE = 0,    /* number: index of the triangle in its mesh, not counting triangles without area */
    SBL_LAMP_LIGHT,           /* number: index of the sbl_light */
    SBL_LAMP_SKY_TEXEL,       /* number: row * width + column in the picture of the environment */
    SBL_LAMP_KIND_COUNT
} sbl_lamp_kind;

typedef struct sbl_sensor_lamp {
    sbl_lamp_kind kind;
    int mesh;                 /* index of the mesh for SBL_LAMP_TRIANGLE, else -1 */
    int number;               /* see sbl_lamp_kind */
    float unhindered[3];      /* R from the lamp if nothing blocks it; 0 if the lamp was picked from a cluster of lamps,
                                 or is a texel of the sky, whose light is known from rays only */
    int rays, open;           /* number of rays that were sent to the lamp, and number of these that reached it */
} sbl_sensor_lamp;

typedef struct sbl_sensor_ray {
    float direction[3];       /* unit vector */
    float distance;           /* world distance to the surface that the ray met, negative for a back face; 0 if it met
                                 none, and for rays towards lamps */
    float radiance[3];        /* radiance along the ray; towards a lamp, an estimate of R from all lamps by this ray
                                 alone, so that the mean over these rays is about sbl_sensor.from_lamps */
    int lamp;                 /* index into sbl_sensor.lamps; -1: a ray over the hemisphere */
} sbl_sensor_ray;

/* One sensor of the last picture. A rasterised sensor has all its views on one sheet:

       hemicube, size S:  +--------+--------+        single:  +--------+
                          |        | side 1 |                 |        |
                          |  top   +--------+                 |  top   |
                          |        | side 2 |                 |        |
                          +--------+--------+                 +--------+
                          | side 3 | side 4 |     a side holds the half above the horizon
                          +--------+--------+

   A traced sensor has rays. Its sheet is one row with a texel per ray; the weights of the texels differ where rays are
   guided. Both kinds of sensors send rays towards lamps, except in SBL_MODE_PAPER, where texels find the emitters. */
typedef struct sbl_sensor {
    sbl_backend backend;      /* SBL_BACKEND_RASTER or SBL_BACKEND_TRACE */
    sbl_site site;            /* the point of the sensor; sbl_gather_readings measures the same light there */
    float position[3];        /* world position of the sensor: the site moved off its surface */
    float normal[3];          /* unit normal of the sensor */
    float radiance[3];        /* R of the pixel's sensor, or of a new sensor if `sensed` is 0: the mean of all looks */
    float noise;              /* standard error of the luminance of R; 0 if it is unknown */
    int looks;                /* number of looks of the sensor. All fields below describe the first look */
    float from_surroundings[3];  /* part of the first look's R: the sum of weight * radiance over the sheet */
    float from_lamps[3];      /* part of R that rays towards lamps have measured */
    float weight_sum;         /* sum of the weights of the sheet: 1 except for a single view */
    float back_share;         /* share of the weight that sees back faces */
    float hit_min, hit_mean;  /* least and mean world distance to the surfaces seen; 0 if there are none */
    int valid;                /* 0: the sensor is stuck inside geometry, or its light overflows */
    int sensed;               /* 0: the pixel was interpolated and had no sensor; the light shown was measured now */
    int level;                /* level of refinement at which the sensor was placed, from 0 */
    int view_count;           /* number of entries in views; 0 if rays were traced */
    sbl_sensor_view views[5];
    int sheet_width, sheet_height;  /* size of the sheet in texels */
    const sbl_sensor_ray *rays;     /* ray_count rays: first those over the hemisphere, then those towards lamps. They
                                       are owned by sbl.h and valid until the next inspection, begin or end */
    const sbl_sensor_lamp *lamps;   /* lamp_count lamps; owned by sbl.h, valid as long as rays */
    int ray_count, lamp_count;
} sbl_sensor;

#if defined(__cplusplus) && !defined(SBL_STATIC)
extern "C" {
#endif

/* >>functions

   Results are listed without SBL_SUCCESS and without the prefix SBL_ERROR_. Each function also returns
   INVALID_ARGUMENT for a NULL context, and STATE if a callback calls it from which it is not allowed, or if the context
   is headless and a GLX context is current (see ON GL STATE). Each mistake in a descriptor is logged. Functions that
   drop work under way keep a finished picture, unless their comment says more. */

/* Creates a context.
   desc: NULL means defaults. out: receives the context, or NULL on failure.
   Results: INVALID_ARGUMENT, OUT_OF_MEMORY, UNSUPPORTED (no GL 3.3, a GL function is missing, no headless GL), GL
   (also if the driver draws a known triangle wrongly). */
SBL_API sbl_result sbl_create(const sbl_context_desc *desc, sbl_context **out);

/* Frees a context and all its GL objects. context: may be NULL. */
SBL_API void sbl_destroy(sbl_context *context);

/* Replaces the scene by a copy of the one that desc describes. Work under way is dropped. An empty scene is allowed and
   shows only sky. Triangles without area are left out, with a warning.
   Results: INVALID_ARGUMENT, OUT_OF_MEMORY, UNSUPPORTED (scene too large), GL. On failure scene and work stay. */
SBL_API sbl_result sbl_set_scene(sbl_context *context, const sbl_scene_desc *desc);

/* Moves one mesh of the scene. Work under way is dropped.
   mesh: index of the mesh. transform: object to world, as sbl_mesh.transform.
   Results: INVALID_ARGUMENT, STATE (no scene), OUT_OF_MEMORY, GL. On failure the mesh stays where it was. */
SBL_API sbl_result sbl_set_mesh_transform(sbl_context *context, int mesh, const float transform[16]);

/* Replaces all materials, or all lights, of the scene: the same number in the same order. Textures keep their numbers.
   Work under way is dropped. If only emission or lights have changed, the update of the bounced light traces no ray
   between surfaces again, unless sbl_end has freed the store's rays. Other changes discard the store.
   Results: INVALID_ARGUMENT, STATE (no scene), UNSUPPORTED (more lamps than the tables of the scene can hold: use
   sbl_set_scene), OUT_OF_MEMORY, GL. On failure the scene stays as it was. */
SBL_API sbl_result sbl_set_materials(sbl_context *context, const sbl_material *materials, int material_count);
SBL_API sbl_result sbl_set_lights(sbl_context *context, const sbl_light *lights, int light_count);

/* Writes the stored bounced light of the scene through put, or reads it back through get, so that a later run need not
   compute it. The scene must be the same to the bit: meshes, materials, textures, lights, sky and environment. Camera,
   max_bounce_cells, preset and seed may differ; light that was made with a smaller max_bounce_cells is loaded with a
   warning (SBL_LOG_ITEM_COARSE_STORE). The error of a load that fails has SBL_LOG_ITEM_OTHER_STORE if the data are
   stored light of another scene, and tells which of its parts differ; it has SBL_LOG_ITEM_INVALID_STORE if the data are
   damaged or something else, so that a host can refuse to overwrite a file that it did not write. Loading drops work
   under way.
   put, get: called for some bytes at a time; they return the number of bytes written or read, and fewer than asked for
   are an error. user: passed to them. The format has a version and a checksum, and uses the machine's byte order.
   Results: INVALID_ARGUMENT (put or get failed; the data are damaged, or of another version, byte order or scene),
   STATE (no scene; save: no light is stored yet), UNSUPPORTED (load: larger than the driver's tables), OUT_OF_MEMORY,
   GL. After a failed load the scene keeps the stored light that it had. */
SBL_API sbl_result sbl_save_store(sbl_context *context, sbl_write_function put, void *user);
SBL_API sbl_result sbl_load_store(sbl_context *context, sbl_read_function get, void *user);

/* Do work in one call: sbl_begin_... below, then sbl_step until the work is done. Results: those of both. */
SBL_API sbl_result sbl_render_picture(sbl_context *context, const sbl_picture_desc *desc);
SBL_API sbl_result sbl_bake_lightmap(sbl_context *context, const sbl_lightmap_desc *desc);
SBL_API sbl_result sbl_bake_vertices(sbl_context *context, const sbl_vertices_desc *desc);
SBL_API sbl_result sbl_gather_readings(sbl_context *context, const sbl_readings_desc *desc);
SBL_API sbl_result sbl_bake_probes(sbl_context *context, const sbl_probes_desc *desc);

/* Starts a picture: checks desc and copies it; sbl_step does the work. Whatever was begun before is dropped, and so is
   a finished picture or lightmap.
   desc: NULL means defaults. Results: INVALID_ARGUMENT, STATE (no scene), UNSUPPORTED (larger than the driver's
   textures). On failure nothing is dropped. */
SBL_API sbl_result sbl_begin_picture(sbl_context *context, const sbl_picture_desc *desc);

/* Starts a lightmap, which takes the place of a picture: the comments on pictures are true for it, from sbl_step to
   sbl_inspect_sensor.
   desc: NULL means defaults. Results: as for sbl_begin_picture, and OUT_OF_MEMORY. */
SBL_API sbl_result sbl_begin_lightmap(sbl_context *context, const sbl_lightmap_desc *desc);

/* Start light at vertices, readings, or probes. Work under way is dropped.
   desc: copied. Its radiance is filled when the work is done; its readings or probes are filled from the first to the
   last while the work goes on.
   Results: INVALID_ARGUMENT (of sites or positions only the first mistakes are logged), STATE (no scene),
   OUT_OF_MEMORY (vertices). */
SBL_API sbl_result sbl_begin_vertices(sbl_context *context, const sbl_vertices_desc *desc);
SBL_API sbl_result sbl_begin_readings(sbl_context *context, const sbl_readings_desc *desc);
SBL_API sbl_result sbl_begin_probes(sbl_context *context, const sbl_probes_desc *desc);

/* Works on whatever was begun last; see ON TIME.
   seconds: roughly how long to work; 0 or less: until the work is done.
   Results: SUCCESS (the work is done), UNFINISHED (call again), CANCELLED, STATE (nothing was begun, or it was
   dropped), OUT_OF_MEMORY, UNSUPPORTED (sensors are larger than the driver's textures), GL. After CANCELLED or an error
   the work is dropped. */
SBL_API sbl_result sbl_step(sbl_context *context, double seconds);

/* Returns how much of the work is done, 0 to 1 (estimated: refinement may find more), or 0 if nothing was begun. */
SBL_API float sbl_progress(const sbl_context *context);

/* Frees whatever was begun: stops work under way, frees a finished picture or lightmap, and frees the memory of the
   store's rays. The stored light itself stays until the scene changes. */
SBL_API void sbl_end(sbl_context *context);

/* Returns the number of floats per pixel of a channel: 3 or 1, or 0 if the channel does not exist. */
SBL_API int sbl_channel_components(sbl_channel channel);

/* Copies a channel of the picture or lightmap. If it is under way, the best so far is copied.
   out: receives width * height * components floats, top row first. float_count: number of floats that out has room for.
   Results: INVALID_ARGUMENT, STATE (no picture), UNFINISHED (nothing to read before the first level is done),
   OUT_OF_MEMORY, GL. INVALID_ARGUMENT, STATE and UNFINISHED leave out as it was. */
SBL_API sbl_result sbl_read_channel(sbl_context *context, sbl_channel channel, float *out, size_t float_count);

/* Returns the GL texture of a channel, or 0 if there is no picture, or nothing to read yet. The texture is a
   GL_TEXTURE_2D of width x height, top row first, with the filter NEAREST. Its format is RGBA32F or RGBA16F; ID has
   R32UI, and other channels of one float have R32F. sbl.h owns the texture. It is valid until the next
   sbl_begin_picture, sbl_begin_lightmap or sbl_end, and while the picture is under way only until the next sbl_step. */
SBL_API uint32_t sbl_channel_texture(sbl_context *context, sbl_channel channel);

/* Shows how the light of pixel (x, y) of the finished picture came about, by measuring it again.
   sensor: receives the sums, views, rays and lamps. radiance: NULL, or receives 4 floats per texel of the sheet, first
   row first: rgb is the radiance, a is the distance to the surface seen, negative for back faces, 0 if there is none.
   weights: NULL, or receives 1 float per texel; their sum is sensor->weight_sum. texel_count: number of texels that
   both arrays have room for. Call with NULL arrays first to learn sheet_width and sheet_height.
   Results: INVALID_ARGUMENT (outside the picture, no surface there, not enough room), STATE (no finished picture, or
   its scene has changed), OUT_OF_MEMORY, GL. On failure sensor stays as it was. */
SBL_API sbl_result sbl_inspect_sensor(sbl_context *context, int x, int y, sbl_sensor *sensor, float *radiance,
                                      float *weights, size_t texel_count);

/* Computes world_to_view of a camera at `eye` that looks at `at`; `up` is the direction that is up in the picture.
   Returns 1, or 0 if the directions are degenerate; then nothing is written. */
SBL_API int sbl_look_at(float world_to_view[16], float eye_x, float eye_y, float eye_z, float at_x, float at_y,
                        float at_z, float up_x, float up_y, float up_z);

/* Computes view_to_clip of a pinhole camera. fov_y: vertical field of view in degrees, below 180. aspect: width /
   height. Returns 1, or 0 if a parameter is out of range; then nothing is written. */
SBL_API int sbl_perspective(float view_to_clip[16], float fov_y, float aspect);

/* Writes linear[i] * scale as 8-bit sRGB (IEC 61966-2-1), rounded, to out[i]. Negative numbers and NaN become 0,
   numbers above 1 become 255. float_count: number of floats, not of pixels. scale: the exposure. */
SBL_API void sbl_encode_srgb8(unsigned char *out, const float *linear, size_t float_count, float scale);

/* Return a copy of desc in which each zero that stands for a default is replaced by it. NULL means all zeroes. The copy
   shows the values that will be used, but work that is begun with it may be slower than with desc: a target_error that
   is set, even to its default, lifts the limit of rays (see ON THE TARGET ERROR), and rays that are set are all traced
   (see sbl_options.rays). */
SBL_API sbl_context_desc sbl_context_desc_defaults(const sbl_context_desc *desc);
SBL_API sbl_picture_desc sbl_picture_desc_defaults(const sbl_picture_desc *desc);
SBL_API sbl_readings_desc sbl_readings_desc_defaults(const sbl_readings_desc *desc);
SBL_API sbl_lightmap_desc sbl_lightmap_desc_defaults(const sbl_lightmap_desc *desc);
SBL_API sbl_probes_desc sbl_probes_desc_defaults(const sbl_probes_desc *desc);
SBL_API sbl_vertices_desc sbl_vertices_desc_defaults(const sbl_vertices_desc *desc);

/* Return a copy of what the context knows, all zeroes for a NULL context. sbl_query_desc has its defaults filled in.
   sbl_query_bounds is all zeroes if there is no scene or an empty one. */
SBL_API sbl_context_desc sbl_query_desc(const sbl_context *context);
SBL_API sbl_capabilities sbl_query_capabilities(const sbl_context *context);
SBL_API sbl_stats sbl_query_stats(const sbl_context *context);
SBL_API sbl_programs sbl_query_programs(const sbl_context *context);
SBL_API sbl_memory sbl_query_memory(const sbl_context *context);
SBL_API sbl_bounds sbl_query_bounds(const sbl_context *context);

/* Return words: the version, such as "0.2.0", a description of a result, and a description of a log item. */
SBL_API const char *sbl_version(void);
SBL_API const char *sbl_result_string(sbl_result result);
SBL_API const char *sbl_log_item_string(sbl_log_item item);

#if defined(__cplusplus) && !defined(SBL_STATIC)
}
#endif

#endif /* SBL_INCLUDED */

/* Stop here if you only want to use it: all that follows is the implementation. */

#ifdef SBL_IMPLEMENTATION
#ifndef SBL_IMPLEMENTATION_INCLUDED
#define SBL_IMPLEMENTATION_INCLUDED

/* ROOMS

   The implementation is divided into rooms. They follow each other in the order of execution, and a function calls only
   functions of its own room and of rooms above it. Search for the tag to find a room.

   the machine    >>base         clock, log, memory, arithmetic
                  >>gl           loads GL functions; saves and restores the GL state of the host
                  >>records      structs that both C and shaders read, each written from one list of fields
                  >>device       textures, targets, programs, draws, time; staged work. No room below calls GL directly
   the scene      >>check        checks descriptors before anything changes
                  >>geometry     reads, checks and converts meshes
                  >>topology     what triangles share: welded vertices, sides, groups, values that spread to neighbours
                  >>solver       least squares by conjugate gradients
                  >>textures     the texels of all textures, in one table
                  >>material     what surfaces do with light: emission, reflection, holes
                  >>environment  the sky: constant radiance and a picture
                  >>bvh          the bounding volume hierarchy that rays traverse
                  >>lamps        everything that sensors send rays to, and the trees that group lamps
                  >>store        bounced light: the cells on surfaces, and the hash grid that finds them
                  >>scene        the rooms above as one scene; GLSL that all shaders share
                  >>options      the descriptors of all front ends: options, defaults, checks
   a sensor       >>atlas        finds the triangle that each texel of a lightmap shows
                  >>surface      the G-buffer of a camera or of a lightmap: which surface point each pixel shows
                  >>sensors      sites, looks, the views of a look, weights
                  >>guide        sends rays to where nearby rays have found light
                  >>aim          rays towards lamps, and the sequences that all rays follow
                  >>raster       measures by drawing views, as the paper does
                  >>trace        measures by tracing rays
                  >>job          the core: takes sites, returns readings, by rays or by views
   bounced light  >>bounce       fills the store: points, rays between surfaces, the solution with all bounces
                  >>saved        writes the store to a stream and reads it
   a picture      >>refine       which pixels get sensors, interpolation, the predicted error
                  >>filter       smooths R
                  >>resolve      composition and anti-aliasing
                  >>gutters      continues a lightmap into the texels around its charts
                  >>seams        makes a lightmap equal on both sides of its seams
   front ends     >>work         what all front ends have in common: begin, step, progress
                  >>map          the radiance map, which pictures and lightmaps share
                  >>picture      pictures
                  >>lightmap     lightmaps
                  >>gather       readings at any points
                  >>vertices     light at vertices, fitted to points on triangles
                  >>probes       light at points in the air
                  >>inspect      one sensor of a finished picture in detail
                  >>trial        draws a known triangle, to find drivers that do not work
   the interface  >>egl          creates the headless GL context
                  >>public       the functions declared above: check, delegate, restore GL

   Each shader is a file, shaders_embedded/NAME.glsl. scripts/embed_shaders copies it between the markers >>glsl of the
   room that uses it. To change a shader, change the file and run the script.


   SYMPTOMS

   Look here first if something is wrong. sbl_inspect_sensor shows the rays and sums of a single pixel. scripts/test
   runs the tests of one room by name, for example scripts/test lights.

   a shadow of a lamp is wrong or noisy                       >>aim (lamps.glsl), then >>lamps
   a shadow is missing, or its edge is coarse                 >>refine: no sensor was placed there
   light leaks through a wall: from lamps or sky              >>trace, >>bvh
   light leaks through or under a wall: bounced light         >>store, >>bounce (cells, cuts)
   bounced light is patchy, too bright or too dark            >>bounce
   bright specks, or grain                                    >>guide, >>trace; only in SBL_MODE_GI: >>bounce
   dark or bright spots at corners and contacts               >>job (stuck tests), >>sensors (offset)
   facets, or wrong normals                                   >>surface (facet_limit), >>geometry
   light is blurred across an edge                            >>filter, >>refine (belongs.glsl)
   edges of objects are jagged                                >>resolve
   wrong colours or texture coordinates                       >>textures, >>geometry
   a wrong sky                                                >>environment
   a lightmap has visible seams, or dark borders              >>seams, >>gutters
   a lightmap shows wrong charts, or hidden texels            >>atlas, >>refine
   light at vertices, or of probes, is wrong                  >>vertices, >>probes
   pictures of two runs differ                                tests/test_determinism.c, then >>sensors (rotation)
   the predicted error is wrong                               >>refine; the error of stored light: >>bounce
   the target error is missed or takes too long               >>refine (rounds), >>guide
   a slow picture: see sbl_stats.seconds                      the room of the largest number
   one sbl_step takes too long, or the driver resets          >>device (pace)
   a driver is refused, draws nothing, or reports GL errors   >>trial, >>gl, >>device
   the GL state of the host has changed                       >>gl (guard)
   a descriptor is refused, or accepted wrongly               >>check


   GLOSSARY

   One word has one meaning, also in private names. The second column is the prefix of such names, in small letters for
   functions and types and in capitals for constants; functions with that prefix stand only in the rooms of the third
   column. tests/tools/words.py checks this table.

   term         prefix            rooms                 meaning
   R                                                    irradiance / pi, the quantity that sensors measure
   guard        sbl__guard        >>gl                  saves, sets and restores the GL state of the host
   record       sbl__record       >>records             a list of fields, from which a C struct and GLSL are made
   table        sbl__table        >>device              data that shaders read by number: a texture or buffer texture
   target       sbl__target       >>device              textures that a pass draws into
   recipe                                               the files, records and features that make a GL program
   pace         sbl__pace         >>device              the measured speed of GL work, and how much to submit at once
   slice        sbl__slice        >>device              the time that one sbl_step has
   stage        sbl__stages       >>device              a part of long work; a table of stages is worked piece by piece
   patch        sbl__patch        >>store               neighbouring triangles that form one smooth surface
   cell                                                 the part of a patch in one cube of the store's grid
   cut                                                  a plane that divides a cell
   leaf         sbl__leaf         >>store               part of a cell, with one value of R (>>bvh, >>lamps: of a tree)
   store        sbl__store        >>store >>textures    the bounced light of the scene: all cells and their R
   point                                                a place where light is measured: in a leaf, or on a triangle
   ring                                                 things equally many steps away from those that have values
   hierarchy    sbl__bvh          >>bvh                 the bounding volume hierarchy over all triangles
   lamp         sbl__lamp         >>lamps               an emitting triangle, a light or a bright texel of the sky
   cluster      sbl__cluster      >>lamps               neighbouring lamps, of which a ray picks one
   rim sample                                           a ray to the corner or rim of a lamp
   atlas        sbl__atlas        >>atlas               the map of a lightmap: its texels and their triangles
   chart                                                triangles that touch in the world and in the atlas
   gutter       sbl__gutters      >>gutters             texels around a chart, which continue its light
   seam         sbl__seam         >>seams               an edge where charts meet in the world, but not in the atlas
   G-buffer     sbl__gbuffer      >>surface             position, normals, colours and id at each pixel
   site         sbl__site         >>sensors >>gather    a point with a normal where light is wanted
   sensor                                               the measurement at a site: one or more looks
   look         sbl__look         >>sensors >>job       one part of a sensor's measurement, with its own rotation
   view         sbl__view         >>sensors             one of the pictures that a rasterised look consists of
   view texture sbl__raster       >>raster              the texture that holds the views of a batch of looks
   batch        sbl__batch        >>guide               looks that are measured together
   slot                                                 the place of a look of a batch in the textures of its results
   layer                                                one kind of light per pixel: layer 0 is R, 1 to 4 are harmonics
   guide        sbl__guide        >>guide >>refine      a histogram of the directions that light comes from
   stuck test                                           rays or a view that tell whether a sensor is inside geometry
   job          sbl__job          >>job                 the measurement of a list of sites
   tile                                                 a rectangle of pixels with a sensor at each corner
   uncertainty                                          a standard error; its square is a variance
   probe        sbl__probe        >>probes              light at a point in the air, for things that move
   front end    sbl__work         >>work                one kind of work that the host can begin, such as a picture


   FOR THOSE WHO CHANGE IT

   Any change is fine if scripts/test passes. tests/test_pinned.c compares pictures to the bit. scripts/compare_commits
   BASE shows what a change does to some 220 pictures and bakes, and to their times. tests/tools/rooms.py lists the
   length of all rooms, and refuses functions of more than 80 lines or 6 parameters, and lines of more than 120 columns.

   To add a channel:
       add it to sbl_channel, with a comment, and add a row to sbl__channels (>>map). If refinement holds its values,
       add a line to sbl__map_channel_pixel; if a target holds them, set sbl__map.channels to it. Add its name to the
       list in examples/sbl_render.c.

   To add a front end:
       write a room like >>gather, which is the shortest. Its struct begins with an sbl__work; its sbl__front_end names
       its functions and its table of stages, in which a loop over many items is a row with turn and count. The stages
       call sbl__work_prepare (hierarchy, lamps, store), sbl__work_make_task (how to measure, and memory), then for each
       job a loop that makes its sites, and sbl__work_sense. Add a row to SBL__FRONT_ENDS (>>public), and declare the
       descriptor and the two functions in the interface.

   To add a kind of light:
       add it to sbl_light_kind, its parameters to sbl_light, and its checks to sbl__check_light. In >>lamps, add its
       fields to SBL__LIGHT_RECORD, its power, and its bounds. In lamps.glsl, extend sbl_lamp (reads the record), the
       closed form of its unobstructed light, and the choice of a point on it. tests/test_lights.c compares each kind
       with closed forms.

   To add a shader, or a table that shaders read:
       add a file to shaders_embedded and a pair of markers to the room that uses it. Declare a recipe: the files of the
       program, the records that they read, and the features that make variants. Call sbl__use before drawing.
       sbl__compile_all (>>public) lists the programs that compile_ahead compiles. SBL__RECORD makes a C struct and the
       GLSL functions sbl_NAME_FIELD(i) from a list of fields.

   To change what a surface does with light (emission, reflection, cut-out):
       edit material.glsl, which all shaders call, and >>material, which computes the same on the CPU;
       tests/test_material.c compares the two. Other shaders must not read a material. A new property of materials goes
       to sbl_material and its checks, and to SBL__OBJECT (>>geometry).

   Work must stay divisible into short pieces. Loops over triangles, pixels or sites must check the slice. Everything
   that draws must ask sbl__pace_begin how much to draw, and report to sbl__pace_end. Neither may change results. */

#include <float.h>
#include <limits.h>
#include <math.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#ifdef _WIN32
  /* These declarations have exactly the types of those in windows.h, so that the host may include windows.h before this
     file, after it, or not at all. No identifier in this file may be a macro of windows.h, such as near, far, small or
     interface; tests/test_windows.sh checks it. */
  #ifdef __cplusplus
  extern "C" {
  #endif
  union _LARGE_INTEGER;
  struct HINSTANCE__;
  typedef intptr_t (__stdcall *sbl__win32_function)(void);
  __declspec(dllimport) int __stdcall QueryPerformanceCounter(union _LARGE_INTEGER *count);
  __declspec(dllimport) int __stdcall QueryPerformanceFrequency(union _LARGE_INTEGER *frequency);
  __declspec(dllimport) struct HINSTANCE__ *__stdcall GetModuleHandleA(const char *name);
  __declspec(dllimport) sbl__win32_function __stdcall GetProcAddress(struct HINSTANCE__ *module, const char *name);
  #ifdef __cplusplus
  }
  #endif
#else
  #include <sys/time.h>
#endif
#ifdef SBL_EGL
  #ifndef EGL_NO_X11
    #define EGL_NO_X11  /* keeps the macros of Xlib (None, Bool, Status) out of the host's file */
    #define SBL__EGL_NO_X11
  #endif
  #include <EGL/egl.h>
  #include <EGL/eglext.h>
  #ifdef SBL__EGL_NO_X11
    #undef EGL_NO_X11
  #endif
#endif

/* ======================================================================================================== >>base
   Helpers that all other rooms use: the clock, the log, memory and arithmetic. */

#define SBL__COUNT(array) ((int)(sizeof(array) / sizeof((array)[0])))
#define SBL__PI 3.14159265358979323846
#define SBL__MIN(a, b) ((a) < (b) ? (a) : (b))
#define SBL__MAX(a, b) ((a) > (b) ? (a) : (b))

/* Returns the time in seconds since an unspecified start. */
static double sbl__now(void) {
#ifdef _WIN32
    int64_t count, frequency;
    QueryPerformanceCounter((union _LARGE_INTEGER *)&count);
    QueryPerformanceFrequency((union _LARGE_INTEGER *)&frequency);
    return (double)count / (double)frequency;
#else
    struct timeval t;
    gettimeofday(&t, NULL);
    return (double)t.tv_sec + 1e-6 * (double)t.tv_usec;
#endif
}

/* The part of the context that every room uses. */
typedef struct sbl__base {
    sbl_allocator allocator;
    sbl_logger logger;
    sbl_memory memory;
} sbl__base;

static void sbl__log(const sbl__base *base, sbl_log_level level, sbl_log_item item, const char *format, ...) {
    char text[512];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    if (base->logger.log) base->logger.log(level, item, text, base->logger.user);
}

static void sbl__default_log(sbl_log_level level, sbl_log_item item, const char *message, void *user) {
    (void)level; (void)item; (void)message; (void)user;
#ifndef SBL_NO_STDIO
    if (level <= SBL_LOG_WARNING)
        fprintf(stderr, "sbl: %s: %s\n", level == SBL_LOG_ERROR ? "error" : "warning", message);
#endif
}

static void *sbl__default_alloc(size_t bytes, void *user) { (void)user; return malloc(bytes); }
static void sbl__default_free(void *pointer, void *user) { (void)user; free(pointer); }

/* Number of bytes that precede a block and hold its size; 16 preserves the alignment of malloc. */
#define SBL__ALLOC_PREFIX 16

/* Allocates count * size bytes with undefined contents. Logs an error and returns NULL if the product overflows or
   memory is exhausted. A count of 0 returns a valid pointer, so NULL always means failure. */
static void *sbl__alloc_raw(sbl__base *base, size_t count, size_t size) {
    char *block = NULL;
    size_t bytes = count * size;
    if (size == 0 || count <= (SIZE_MAX - SBL__ALLOC_PREFIX) / size)
        block = (char *)base->allocator.alloc(bytes + SBL__ALLOC_PREFIX, base->allocator.user);
    if (!block) {
        sbl__log(base, SBL_LOG_ERROR, SBL_LOG_ITEM_OUT_OF_MEMORY,
                 "out of memory: the allocator refused %.0f bytes of host memory; use a smaller scene or picture",
                 (double)count * (double)size);
        return NULL;
    }
    memcpy(block, &bytes, sizeof bytes);
    base->memory.host_bytes += bytes;
    if (base->memory.host_bytes > base->memory.host_peak_bytes) base->memory.host_peak_bytes = base->memory.host_bytes;
    return block + SBL__ALLOC_PREFIX;
}

/* Like sbl__alloc_raw, but the contents are zero. */
static void *sbl__alloc(sbl__base *base, size_t count, size_t size) {
    void *block = sbl__alloc_raw(base, count, size);
    if (block) memset(block, 0, count * size);
    return block;
}

static void sbl__free(sbl__base *base, void *pointer) {
    size_t bytes;
    if (!pointer) return;
    memcpy(&bytes, (char *)pointer - SBL__ALLOC_PREFIX, sizeof bytes);
    base->memory.host_bytes -= bytes;
    base->allocator.free((char *)pointer - SBL__ALLOC_PREFIX, base->allocator.user);
}

/* Enlarges an array if needed, so that it can hold `needed` elements of `size` bytes. array: address of the pointer to
   it; *room: its capacity in elements, which at least doubles, so that appending takes constant time on average.
   Returns 1 on success; returns 0 and changes nothing if memory is exhausted. */
static int sbl__grow(sbl__base *base, void *array, int *room, int needed, size_t size) {
    const int more = needed > INT_MAX / 2 - 1024 ? needed : SBL__MAX(needed, *room * 2 + 1024);
    void *old, *grown;
    if (needed <= *room) return 1;
    memcpy(&old, array, sizeof old);
    grown = sbl__alloc_raw(base, (size_t)more, size);
    if (!grown) return 0;
    if (*room) memcpy(grown, old, (size_t)*room * size);
    sbl__free(base, old);
    memcpy(array, &grown, sizeof grown);
    *room = more;
    return 1;
}

/* Numbers from the host are tested by their bits before any arithmetic uses them. With -ffast-math the compiler assumes
   that infinity and NaN do not occur, so comparisons of floats cannot detect them. */
static uint32_t sbl__float_bits(const float *x) {
    uint32_t bits;
    memcpy(&bits, x, sizeof bits);
    return bits;
}

static int sbl__all_finite(const float *x, int count) {
    int i;
    for (i = 0; i < count; i++) if ((sbl__float_bits(x + i) & 0x7f800000u) == 0x7f800000u) return 0;
    return 1;
}

static int sbl__all_zero(const float *x, int count) {
    int i;
    for (i = 0; i < count; i++) if (sbl__float_bits(x + i) << 1) return 0;
    return 1;
}

static int sbl__finite(const float *x) { return sbl__all_finite(x, 1); }
static int sbl__zero(const float *x) { return sbl__all_zero(x, 1); }
static int sbl__between(const float *x, float low, float high) { return sbl__finite(x) && *x >= low && *x <= high; }

static float sbl__dot(const float a[3], const float b[3]) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

#define SBL__LUMINANCE_WEIGHTS 0.2126f, 0.7152f, 0.0722f  /* for linear sRGB: red, green, blue */
static const float sbl__luminance_weights[3] = { SBL__LUMINANCE_WEIGHTS };
static float sbl__luminance(const float c[3]) { return sbl__dot(sbl__luminance_weights, c); }
static float sbl__max3(const float a[3]) { return SBL__MAX(a[0], SBL__MAX(a[1], a[2])); }
static double sbl__sum3(const float v[3]) { return (double)v[0] + v[1] + v[2]; }

static void sbl__cross(const double a[3], const double b[3], double out[3]) {
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

/* Computes the cross product of a triangle's edges p[1] - p[0] and p[2] - p[0]. Its length is twice the area. */
static void sbl__triangle_normal(const float *const p[3], double normal[3]) {
    double a[3], b[3];
    int k;
    for (k = 0; k < 3; k++) {
        a[k] = (double)p[1][k] - p[0][k];
        b[k] = (double)p[2][k] - p[0][k];
    }
    sbl__cross(a, b, normal);
}

/* Scales v to unit length and returns 1. If the length of v is 0, infinite or NaN, returns 0 and leaves v unchanged. */
static int sbl__normalize(double v[3]) {
    double length = sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
    if (!(length > 0.0) || !(length < DBL_MAX)) return 0;
    v[0] /= length; v[1] /= length; v[2] /= length;
    return 1;
}

/* Computes out = a * b; all matrices are column-major. */
static void sbl__multiply(float out[16], const float a[16], const float b[16]) {
    int column, row, k;
    for (column = 0; column < 4; column++)
        for (row = 0; row < 4; row++) {
            double sum = 0;
            for (k = 0; k < 4; k++) sum += (double)a[4 * k + row] * (double)b[4 * column + k];
            out[4 * column + row] = (float)sum;
        }
}

static void sbl__identity(float m[16]) {
    int i;
    for (i = 0; i < 16; i++) m[i] = i % 5 == 0 ? 1.0f : 0.0f;
}

/* Returns the determinant of a column-major matrix, or 0 if it is not affine (its last row is not 0 0 0 1). */
static double sbl__affine_determinant(const float m[16]) {
    if (m[3] != 0.0f || m[7] != 0.0f || m[11] != 0.0f || m[15] != 1.0f) return 0;
    return (double)m[0] * ((double)m[5] * m[10] - (double)m[6] * m[9]) -
           (double)m[4] * ((double)m[1] * m[10] - (double)m[2] * m[9]) +
           (double)m[8] * ((double)m[1] * m[6] - (double)m[2] * m[5]);
}

/* PCG hash (Jarzynski and Olano 2020, "Hash Functions for GPU Rendering") */
static uint32_t sbl__hash(uint32_t x) {
    uint32_t word;
    x = x * 747796405u + 2891336453u;
    word = ((x >> ((x >> 28) + 4u)) ^ x) * 277803737u;
    return (word >> 22) ^ word;
}

/* Continues `hash` over a block of memory, with FNV-1a (Fowler, Noll, Vo) over 32-bit words instead of bytes, and a
   shift after each word that mixes high bits into low ones. An incomplete last word is padded with zeroes. */
static uint64_t sbl__hash_bytes(uint64_t hash, const void *data, size_t bytes) {
    const unsigned char *at = (const unsigned char *)data;
    size_t i;
    for (i = 0; i < bytes; i += 4) {
        uint32_t word = 0;
        memcpy(&word, at + i, bytes - i < 4 ? bytes - i : 4);
        hash = (hash ^ word) * 0x100000001b3u;
        hash ^= hash >> 29;
    }
    return hash;
}

/* Converts a finite number to a 16-bit float, rounding to nearest even. Numbers out of range become 65504 or -65504. */
static uint16_t sbl__to_half(float value) {
    const uint32_t bits = sbl__float_bits(&value), sign = (bits >> 16) & 0x8000u;
    const uint32_t mantissa = (bits & 0x7fffffu) | 0x800000u;
    const int exponent = (int)((bits >> 23) & 255u) - 127, shift = exponent < -14 ? -1 - exponent : 13;
    uint32_t rest, half;
    if (exponent > 15) return (uint16_t)(sign | 0x7bffu);
    if (exponent < -25) return (uint16_t)sign;
    half = exponent < -14 ? mantissa >> shift : (uint32_t)(exponent + 14) * 1024u + (mantissa >> 13);
    rest = mantissa & ((1u << shift) - 1u);
    if (rest > (1u << (shift - 1)) || (rest == (1u << (shift - 1)) && (half & 1u))) half++;
    return (uint16_t)(sign | SBL__MIN(half, 0x7bffu));
}

/* Converts a 16-bit float to a 32-bit float. Infinity and NaN are preserved. */
static float sbl__from_half(uint16_t half) {
    int exponent = (half >> 10) & 31, mantissa = half & 1023;
    const double value = exponent ? ldexp((double)(mantissa + 1024), exponent - 25) : ldexp((double)mantissa, -24);
    const uint32_t not_finite = (half & 0x8000u) << 16 | 0x7f800000u | (uint32_t)mantissa << 13;
    float x = (float)(half & 0x8000 ? -value : value);
    if (exponent == 31) memcpy(&x, &not_finite, sizeof x);
    return x;
}

static float sbl__srgb_to_linear(float x) {
    return x <= 0.04045f ? x / 12.92f : (float)pow((x + 0.055) / 1.055, 2.4);
}

static float sbl__linear_to_srgb(float x) {
    return x <= 0.0031308f ? 12.92f * x : (float)(1.055 * pow(x, 1 / 2.4) - 0.055);
}

/* Maps 0 .. 1 to the integers 0 .. 255, rounding to nearest. Numbers outside 0 .. 1 are clamped. */
static unsigned char sbl__to_byte(float x) {
    return (unsigned char)(255.0f * SBL__MIN(SBL__MAX(x, 0.0f), 1.0f) + 0.5f);
}

/* ======================================================================================================== >>gl
   Loads the GL functions, reads GL errors, and saves and restores the GL state of the host. */

#ifdef _WIN32
  #define SBL__GLAPI __stdcall
#else
  #define SBL__GLAPI
#endif

/* GL functions that the library requires: X(return type, name without "gl", parameters) */
#define SBL__GL_FUNCTIONS(X) \
    X(void, ActiveTexture, (unsigned unit)) \
    X(void, AttachShader, (unsigned program, unsigned shader)) \
    X(void, BindBuffer, (unsigned target, unsigned buffer)) \
    X(void, BindFramebuffer, (unsigned target, unsigned framebuffer)) \
    X(void, BindSampler, (unsigned unit, unsigned sampler)) \
    X(void, BindTexture, (unsigned target, unsigned texture)) \
    X(void, BindVertexArray, (unsigned array)) \
    X(void, BufferData, (unsigned target, ptrdiff_t size, const void *data, unsigned usage)) \
    X(void, BufferSubData, (unsigned target, ptrdiff_t offset, ptrdiff_t size, const void *data)) \
    X(unsigned, CheckFramebufferStatus, (unsigned target)) \
    X(void, ClampColor, (unsigned target, unsigned clamp)) \
    X(void, ClearBufferfv, (unsigned buffer, int index, const float *value)) \
    X(void, ClearBufferuiv, (unsigned buffer, int index, const unsigned *value)) \
    X(void, ColorMaski, (unsigned index, unsigned char r, unsigned char g, unsigned char b, unsigned char a)) \
    X(void, CompileShader, (unsigned shader)) \
    X(unsigned, CreateProgram, (void)) \
    X(unsigned, CreateShader, (unsigned type)) \
    X(void, DeleteBuffers, (int count, const unsigned *names)) \
    X(void, DeleteFramebuffers, (int count, const unsigned *names)) \
    X(void, DeleteProgram, (unsigned program)) \
    X(void, DeleteSamplers, (int count, const unsigned *names)) \
    X(void, DeleteShader, (unsigned shader)) \
    X(void, DeleteTextures, (int count, const unsigned *names)) \
    X(void, DeleteVertexArrays, (int count, const unsigned *names)) \
    X(void, DepthFunc, (unsigned function)) \
    X(void, DepthMask, (unsigned char on)) \
    X(void, DepthRange, (double nearest, double farthest)) \
    X(void, Disable, (unsigned capability)) \
    X(void, Disablei, (unsigned capability, unsigned index)) \
    X(void, DrawBuffers, (int count, const unsigned *buffers)) \
    X(void, DrawArraysInstanced, (unsigned mode, int first, int count, int instances)) \
    X(void, DrawElementsInstanced, (unsigned mode, int count, unsigned type, const void *offset, int instances)) \
    X(void, Enable, (unsigned capability)) \
    X(void, Enablei, (unsigned capability, unsigned index)) \
    X(void, EnableVertexAttribArray, (unsigned index)) \
    X(void, Finish, (void)) \
    X(void, Flush, (void)) \
    X(void, FrontFace, (unsigned direction)) \
    X(void, FramebufferTexture2D, (unsigned target, unsigned attachment, unsigned kind, unsigned texture, int level)) \
    X(void, GenBuffers, (int count, unsigned *names)) \
    X(void, GenFramebuffers, (int count, unsigned *names)) \
    X(void, GenSamplers, (int count, unsigned *names)) \
    X(void, GenTextures, (int count, unsigned *names)) \
    X(void, GenVertexArrays, (int count, unsigned *names)) \
    X(void, GetActiveUniform, (unsigned program, unsigned index, int room, int *length, int *size, unsigned *type, \
      char *name)) \
    X(void, GetBooleani_v, (unsigned name, unsigned index, unsigned char *out)) \
    X(void, GetBufferParameteri64v, (unsigned target, unsigned name, int64_t *out)) \
    X(void, GetBufferSubData, (unsigned target, ptrdiff_t offset, ptrdiff_t size, void *data)) \
    X(void, GetDoublev, (unsigned name, double *out)) \
    X(unsigned, GetError, (void)) \
    X(void, GetIntegerv, (unsigned name, int *out)) \
    X(void, GetProgramInfoLog, (unsigned program, int room, int *length, char *text)) \
    X(void, GetProgramiv, (unsigned program, unsigned name, int *out)) \
    X(void, GetShaderInfoLog, (unsigned shader, int room, int *length, char *text)) \
    X(void, GetShaderiv, (unsigned shader, unsigned name, int *out)) \
    X(const unsigned char *, GetString, (unsigned name)) \
    X(const unsigned char *, GetStringi, (unsigned name, unsigned index)) \
    X(void, GetTexLevelParameteriv, (unsigned target, int level, unsigned name, int *out)) \
    X(int, GetUniformLocation, (unsigned program, const char *name)) \
    X(unsigned char, IsBuffer, (unsigned name)) \
    X(unsigned char, IsEnabled, (unsigned capability)) \
    X(unsigned char, IsEnabledi, (unsigned capability, unsigned index)) \
    X(unsigned char, IsTexture, (unsigned name)) \
    X(void, LinkProgram, (unsigned program)) \
    X(void, PixelStorei, (unsigned name, int value)) \
    X(void, PolygonMode, (unsigned face, unsigned mode)) \
    X(void, ReadBuffer, (unsigned buffer)) \
    X(void, ReadPixels, (int x, int y, int width, int height, unsigned format, unsigned type, void *pixels)) \
    X(void, SamplerParameteri, (unsigned sampler, unsigned name, int value)) \
    X(void, Scissor, (int x, int y, int width, int height)) \
    X(void, ShaderSource, (unsigned shader, int count, const char *const *strings, const int *lengths)) \
    X(void, TexBuffer, (unsigned target, unsigned format, unsigned buffer)) \
    X(void, TexImage2D, (unsigned target, int level, int internal_format, int width, int height, int border, \
      unsigned format, unsigned type, const void *pixels)) \
    X(void, TexParameteri, (unsigned target, unsigned name, int value)) \
    X(void, TexSubImage2D, (unsigned target, int level, int x, int y, int width, int height, unsigned format, \
      unsigned type, const void *pixels)) \
    X(void, Uniform1f, (int location, float x)) \
    X(void, Uniform1i, (int location, int x)) \
    X(void, Uniform2f, (int location, float x, float y)) \
    X(void, Uniform2i, (int location, int x, int y)) \
    X(void, Uniform3f, (int location, float x, float y, float z)) \
    X(void, Uniform4f, (int location, float x, float y, float z, float w)) \
    X(void, UseProgram, (unsigned program)) \
    X(void, VertexAttribDivisor, (unsigned index, unsigned divisor)) \
    X(void, VertexAttribIPointer, (unsigned index, int size, unsigned type, int stride, const void *offset)) \
    X(void, VertexAttribPointer, (unsigned index, int size, unsigned type, unsigned char normalized, \
      int stride, const void *offset)) \
    X(void, Viewport, (int x, int y, int width, int height))

/* GL functions that the library uses if the driver has them */
#define SBL__GL_OPTIONAL_FUNCTIONS(X) \
    X(void, BindImageTexture, (unsigned unit, unsigned texture, int level, unsigned char layered, int layer, \
      unsigned access, unsigned format)) \
    X(void, ClipControl, (unsigned origin, unsigned depth)) \
    X(void, DepthRangeIndexed, (unsigned index, double nearest, double farthest)) \
    X(void, DispatchCompute, (unsigned x, unsigned y, unsigned z)) \
    X(void, GetDoublei_v, (unsigned name, unsigned index, double *out)) \
    X(void, GetFloati_v, (unsigned name, unsigned index, float *out)) \
    X(void, GetIntegeri_v, (unsigned name, unsigned index, int *out)) \
    X(void, MemoryBarrier, (unsigned what)) \
    X(void, ScissorIndexedv, (unsigned index, const int *box)) \
    X(void, ViewportIndexedfv, (unsigned index, const float *box))

/* Numbers of texture units, draw buffers, viewports and image units whose state the guard saves and restores. Programs
   may use no other texture or image units. */
#define SBL__GUARD_UNITS 13
#define SBL__GUARD_DRAW_BUFFERS 8
#define SBL__GUARD_VIEWPORTS 16
#define SBL__GUARD_IMAGES 6

typedef struct sbl__gl {
    sbl__base *base;
    const char *doing;  /* current activity, for messages such as "GL error 0x0502 while storing meshes" */
#define SBL__X(type, name, parameters) type (SBL__GLAPI *name) parameters;
    SBL__GL_FUNCTIONS(SBL__X)
    SBL__GL_OPTIONAL_FUNCTIONS(SBL__X)
#undef SBL__X
    sbl_capabilities capabilities;
    int viewports;  /* viewports to guard; 1 if the driver has no viewport array (GL 4.1) */
    int units;      /* texture units that a program may use */
} sbl__gl;

enum {
    SBL__GL_NO_ERROR = 0, SBL__GL_OUT_OF_MEMORY = 0x0505, SBL__GL_TRIANGLES = 0x0004,
    SBL__GL_TRIANGLE_STRIP = 0x0005, SBL__GL_GREATER = 0x0204, SBL__GL_FRONT_AND_BACK = 0x0408,
    SBL__GL_POLYGON_MODE = 0x0B40, SBL__GL_FILL = 0x1B02, SBL__GL_CULL_FACE = 0x0B44, SBL__GL_FRONT_FACE = 0x0B46,
    SBL__GL_CCW = 0x0901, SBL__GL_DEPTH_RANGE = 0x0B70, SBL__GL_DEPTH_TEST = 0x0B71,
    SBL__GL_DEPTH_WRITEMASK = 0x0B72, SBL__GL_DEPTH_FUNC = 0x0B74, SBL__GL_STENCIL_TEST = 0x0B90,
    SBL__GL_VIEWPORT = 0x0BA2, SBL__GL_BLEND = 0x0BE2, SBL__GL_COLOR_LOGIC_OP = 0x0BF2,
    SBL__GL_SCISSOR_BOX = 0x0C10, SBL__GL_SCISSOR_TEST = 0x0C11, SBL__GL_COLOR_WRITEMASK = 0x0C23,
    SBL__GL_DITHER = 0x0BD0, SBL__GL_UNPACK_SWAP_BYTES = 0x0CF0, SBL__GL_UNPACK_ROW_LENGTH = 0x0CF2,
    SBL__GL_UNPACK_SKIP_ROWS = 0x0CF3, SBL__GL_UNPACK_SKIP_PIXELS = 0x0CF4, SBL__GL_UNPACK_ALIGNMENT = 0x0CF5,
    SBL__GL_PACK_SWAP_BYTES = 0x0D00, SBL__GL_PACK_ROW_LENGTH = 0x0D02, SBL__GL_PACK_SKIP_ROWS = 0x0D03,
    SBL__GL_PACK_SKIP_PIXELS = 0x0D04, SBL__GL_PACK_ALIGNMENT = 0x0D05, SBL__GL_MAX_TEXTURE_SIZE = 0x0D33,
    SBL__GL_TEXTURE_2D = 0x0DE1, SBL__GL_TEXTURE_WIDTH = 0x1000, SBL__GL_TEXTURE_HEIGHT = 0x1001,
    SBL__GL_UNSIGNED_BYTE = 0x1401, SBL__GL_UNSIGNED_INT = 0x1405, SBL__GL_FLOAT = 0x1406,
    SBL__GL_HALF_FLOAT = 0x140B, SBL__GL_COLOR = 0x1800, SBL__GL_DEPTH = 0x1801, SBL__GL_DEPTH_COMPONENT = 0x1902,
    SBL__GL_RED = 0x1903, SBL__GL_RGBA = 0x1908, SBL__GL_RENDERER = 0x1F01, SBL__GL_VERSION = 0x1F02,
    SBL__GL_EXTENSIONS = 0x1F03, SBL__GL_NEAREST = 0x2600, SBL__GL_TEXTURE_MAG_FILTER = 0x2800,
    SBL__GL_TEXTURE_MIN_FILTER = 0x2801, SBL__GL_TEXTURE_WRAP_S = 0x2802, SBL__GL_TEXTURE_WRAP_T = 0x2803,
    SBL__GL_TEXTURE_MAX_LEVEL = 0x813D, SBL__GL_CLAMP_TO_EDGE = 0x812F, SBL__GL_POLYGON_OFFSET_FILL = 0x8037,
    SBL__GL_TEXTURE_BINDING_2D = 0x8069, SBL__GL_POLYGON_SMOOTH = 0x0B41, SBL__GL_MULTISAMPLE = 0x809D,
    SBL__GL_SAMPLE_ALPHA_TO_COVERAGE = 0x809E, SBL__GL_SAMPLE_ALPHA_TO_ONE = 0x809F,
    SBL__GL_SAMPLE_COVERAGE = 0x80A0, SBL__GL_SAMPLE_SHADING = 0x8C36, SBL__GL_SAMPLE_MASK = 0x8E51,
    SBL__GL_MAJOR_VERSION = 0x821B, SBL__GL_MINOR_VERSION = 0x821C, SBL__GL_NUM_EXTENSIONS = 0x821D,
    SBL__GL_RG = 0x8227, SBL__GL_RG_INTEGER = 0x8228, SBL__GL_RED_INTEGER = 0x8D94, SBL__GL_RGBA_INTEGER = 0x8D99,
    SBL__GL_R32F = 0x822E, SBL__GL_RG32F = 0x8230, SBL__GL_R32UI = 0x8236, SBL__GL_RGBA32UI = 0x8D70,
    SBL__GL_RGBA32F = 0x8814, SBL__GL_RGBA16F = 0x881A, SBL__GL_RG32UI = 0x823C, SBL__GL_SRGB8_ALPHA8 = 0x8C43,
    SBL__GL_DEPTH_COMPONENT32F = 0x8CAC, SBL__GL_TEXTURE0 = 0x84C0, SBL__GL_ACTIVE_TEXTURE = 0x84E0,
    SBL__GL_DEPTH_CLAMP = 0x864F, SBL__GL_VERTEX_ARRAY_BINDING = 0x85B5, SBL__GL_MAX_VIEWPORTS = 0x825B,
    SBL__GL_CLAMP_READ_COLOR = 0x891C, SBL__GL_BUFFER_SIZE = 0x8764, SBL__GL_ARRAY_BUFFER = 0x8892,
    SBL__GL_ELEMENT_ARRAY_BUFFER = 0x8893, SBL__GL_ARRAY_BUFFER_BINDING = 0x8894, SBL__GL_STREAM_DRAW = 0x88E0,
    SBL__GL_STATIC_DRAW = 0x88E4, SBL__GL_PIXEL_PACK_BUFFER = 0x88EB, SBL__GL_PIXEL_UNPACK_BUFFER = 0x88EC,
    SBL__GL_PIXEL_PACK_BUFFER_BINDING = 0x88ED, SBL__GL_PIXEL_UNPACK_BUFFER_BINDING = 0x88EF,
    SBL__GL_SAMPLER_BINDING = 0x8919, SBL__GL_FRAGMENT_SHADER = 0x8B30, SBL__GL_VERTEX_SHADER = 0x8B31,
    SBL__GL_COMPILE_STATUS = 0x8B81, SBL__GL_LINK_STATUS = 0x8B82, SBL__GL_CURRENT_PROGRAM = 0x8B8D,
    SBL__GL_MAX_TEXTURE_IMAGE_UNITS = 0x8872, SBL__GL_ACTIVE_UNIFORMS = 0x8B86, SBL__GL_SAMPLER_2D = 0x8B5E,
    SBL__GL_UNSIGNED_INT_SAMPLER_2D = 0x8DD2, SBL__GL_UNSIGNED_INT_SAMPLER_BUFFER = 0x8DD8,
    SBL__GL_TEXTURE_BUFFER = 0x8C2A, SBL__GL_MAX_TEXTURE_BUFFER_SIZE = 0x8C2B,
    SBL__GL_TEXTURE_BINDING_BUFFER = 0x8C2C, SBL__GL_RASTERIZER_DISCARD = 0x8C89,
    SBL__GL_DRAW_FRAMEBUFFER_BINDING = 0x8CA6, SBL__GL_READ_FRAMEBUFFER = 0x8CA8, SBL__GL_DRAW_FRAMEBUFFER = 0x8CA9,
    SBL__GL_READ_FRAMEBUFFER_BINDING = 0x8CAA, SBL__GL_FRAMEBUFFER_COMPLETE = 0x8CD5,
    SBL__GL_COLOR_ATTACHMENT0 = 0x8CE0, SBL__GL_DEPTH_ATTACHMENT = 0x8D00, SBL__GL_FRAMEBUFFER_SRGB = 0x8DB9,
    SBL__GL_PRIMITIVE_RESTART_FIXED_INDEX = 0x8D69, SBL__GL_COPY_READ_BUFFER = 0x8F36,
    SBL__GL_PRIMITIVE_RESTART = 0x8F9D, SBL__GL_CLIP_DISTANCE0 = 0x3000, SBL__GL_IMAGE_BINDING_NAME = 0x8F3A,
    SBL__GL_IMAGE_BINDING_LEVEL = 0x8F3B, SBL__GL_IMAGE_BINDING_LAYERED = 0x8F3C,
    SBL__GL_IMAGE_BINDING_LAYER = 0x8F3D, SBL__GL_IMAGE_BINDING_ACCESS = 0x8F3E,
    SBL__GL_IMAGE_BINDING_FORMAT = 0x906E, SBL__GL_COMPUTE_SHADER = 0x91B9, SBL__GL_WRITE_ONLY = 0x88B9,
    SBL__GL_TEXTURE_FETCH_BARRIER = 0x0008, SBL__GL_SHADER_IMAGE_ACCESS_BARRIER = 0x0020,
    SBL__GL_FRAMEBUFFER_BARRIER = 0x0400, SBL__GL_CLIP_ORIGIN = 0x935C, SBL__GL_CLIP_DEPTH_MODE = 0x935D,
    SBL__GL_LOWER_LEFT = 0x8CA1, SBL__GL_NEGATIVE_ONE_TO_ONE = 0x935E, SBL__GL_ZERO_TO_ONE = 0x935F
};

/* Reads, clears and logs all GL errors. Returns SBL_SUCCESS if there was none, SBL_ERROR_OUT_OF_MEMORY if one was
   GL_OUT_OF_MEMORY, otherwise SBL_ERROR_GL. */
static sbl_result sbl__gl_check(const sbl__gl *gl) {
    sbl_result result = SBL_SUCCESS;
    int i;
    for (i = 0; i < 32; i++) {  /* the loop is limited because a lost context reports errors for ever */
        unsigned error = gl->GetError();
        if (error == SBL__GL_NO_ERROR) break;
        if (error == SBL__GL_OUT_OF_MEMORY) {
            sbl__log(gl->base, SBL_LOG_ERROR, SBL_LOG_ITEM_OUT_OF_MEMORY,
                     "the GPU is out of memory while %s; use a smaller scene or picture, or a smaller texture for "
                     "sensors (see sbl_context_desc)", gl->doing);
            result = SBL_ERROR_OUT_OF_MEMORY;
        } else {
            sbl__log(gl->base, SBL_LOG_ERROR, SBL_LOG_ITEM_GL_ERROR, "GL error 0x%04x while %s", error, gl->doing);
            if (result == SBL_SUCCESS) result = SBL_ERROR_GL;
        }
    }
    return result;
}

static void sbl__gl_clear_errors(const sbl__gl *gl) {
    int i;
    for (i = 0; i < 32 && gl->GetError() != SBL__GL_NO_ERROR; i++) {}
}

static int sbl__gl_has_extension(const sbl__gl *gl, const char *name) {
    int i, count = 0;
    gl->GetIntegerv(SBL__GL_NUM_EXTENSIONS, &count);
    for (i = 0; i < count; i++) {
        const char *extension = (const char *)gl->GetStringi(SBL__GL_EXTENSIONS, (unsigned)i);
        if (extension && strcmp(extension, name) == 0) return 1;
    }
    return 0;
}

/* version: 10 * major + minor, such as 43 for GL 4.3 */
static int sbl__gl_at_least(const sbl__gl *gl, int version) {
    return gl->capabilities.gl_major * 10 + gl->capabilities.gl_minor >= version;
}

/* Looks up a GL function with the host's loader. Returns NULL if it does not exist. For functions of GL 1.1, which
   opengl32.dll exports itself, wglGetProcAddress returns NULL or, with some drivers, 1, 2, 3 or -1. They are then
   looked up in opengl32.dll, which the host must have loaded. */
static sbl_gl_function sbl__gl_find(const sbl_context_desc *desc, const char *name) {
    const sbl_gl_function found = desc->get_gl_function(name, desc->gl_user);
    if ((intptr_t)found < -1 || (intptr_t)found > 3) return found;
#ifdef _WIN32
    {
        struct HINSTANCE__ *module = GetModuleHandleA("opengl32.dll");
        if (module) return (sbl_gl_function)GetProcAddress(module, name);
    }
#endif
    return NULL;
}

/* Loads all GL functions. Returns 1 on success. Logs each required function that is missing and returns 0. */
static int sbl__gl_load_functions(sbl__gl *gl, const sbl_context_desc *desc) {
    int missing = 0;
#define SBL__LOAD(type, name, parameters) \
    gl->name = (type (SBL__GLAPI *) parameters)sbl__gl_find(desc, "gl" #name);
#define SBL__LOAD_NEEDED(type, name, parameters) \
    SBL__LOAD(type, name, parameters) \
    if (!gl->name) { \
        missing++; \
        sbl__log(gl->base, SBL_LOG_ERROR, SBL_LOG_ITEM_GL_FUNCTION_MISSING, \
                 "the GL loader did not find gl" #name "; sbl.h needs an OpenGL 3.3 core context that is current in " \
                 "this thread"); \
    }
    SBL__GL_FUNCTIONS(SBL__LOAD_NEEDED)
    if (missing) return 0;
    SBL__GL_OPTIONAL_FUNCTIONS(SBL__LOAD)
#undef SBL__LOAD_NEEDED
#undef SBL__LOAD
    return 1;
}

/* Loads the GL functions and fills gl->capabilities, gl->units and gl->viewports. Optional features are used if the
   driver has them, except for those in desc->disabled. */
static sbl_result sbl__gl_load(sbl__gl *gl, const sbl_context_desc *desc) {
    sbl_capabilities *c = &gl->capabilities;
    const char *text;
    gl->doing = "starting";
    if (!sbl__gl_load_functions(gl, desc)) return SBL_ERROR_UNSUPPORTED;
    sbl__gl_clear_errors(gl);
    text = (const char *)gl->GetString(SBL__GL_VERSION);
    if (text) snprintf(c->version, sizeof c->version, "%s", text);
    text = (const char *)gl->GetString(SBL__GL_RENDERER);
    if (text) snprintf(c->renderer, sizeof c->renderer, "%s", text);
    gl->GetIntegerv(SBL__GL_MAJOR_VERSION, &c->gl_major);
    gl->GetIntegerv(SBL__GL_MINOR_VERSION, &c->gl_minor);
    if (!sbl__gl_at_least(gl, 33) || strstr(c->version, "OpenGL ES")) {
        sbl__log(gl->base, SBL_LOG_ERROR, SBL_LOG_ITEM_NO_GL, "the current GL context is \"%s\"; sbl.h needs a "
                 "context of OpenGL 3.3 or later (not OpenGL ES) that is current in this thread",
                 c->version[0] ? c->version : "none");
        return SBL_ERROR_UNSUPPORTED;
    }
    gl->GetIntegerv(SBL__GL_MAX_TEXTURE_SIZE, &c->max_texture_size);
    gl->GetIntegerv(SBL__GL_MAX_TEXTURE_BUFFER_SIZE, &c->max_texture_buffer_size);
    gl->GetIntegerv(SBL__GL_MAX_TEXTURE_IMAGE_UNITS, &gl->units);
    gl->units = SBL__MIN(gl->units, SBL__GUARD_UNITS);
    if (gl->ClipControl && (sbl__gl_at_least(gl, 45) || sbl__gl_has_extension(gl, "GL_ARB_clip_control")))
        c->available |= SBL_CAPABILITY_CLIP_CONTROL;
    if (sbl__gl_at_least(gl, 43) && gl->BindImageTexture && gl->DispatchCompute && gl->GetIntegeri_v &&
        gl->MemoryBarrier) c->available |= SBL_CAPABILITY_COMPUTE;
    c->used = c->available & ~desc->disabled;
    gl->viewports = 1;
    if (sbl__gl_at_least(gl, 41) && gl->DepthRangeIndexed && gl->GetDoublei_v && gl->GetFloati_v &&
        gl->GetIntegeri_v && gl->ScissorIndexedv && gl->ViewportIndexedfv) {
        gl->GetIntegerv(SBL__GL_MAX_VIEWPORTS, &gl->viewports);
        gl->viewports = SBL__MAX(1, SBL__MIN(gl->viewports, SBL__GUARD_VIEWPORTS));
    }
    sbl__gl_clear_errors(gl);
    return SBL_SUCCESS;
}

/* The state guard saves all GL state that the library changes at the start of a public function, and restores it
   before the function returns. sbl__guard_force sets the state that passes rely on, after the state has been saved and
   after each call of the host's draw callback. */

/* Capabilities of glEnable. The last two need GL 4.0 and 4.3, see sbl__guard_switch_count. */
static const unsigned sbl__guard_switches[] = {
    SBL__GL_CULL_FACE, SBL__GL_DEPTH_TEST, SBL__GL_STENCIL_TEST, SBL__GL_SCISSOR_TEST, SBL__GL_COLOR_LOGIC_OP,
    SBL__GL_DITHER, SBL__GL_POLYGON_OFFSET_FILL, SBL__GL_POLYGON_SMOOTH, SBL__GL_MULTISAMPLE,
    SBL__GL_SAMPLE_ALPHA_TO_COVERAGE, SBL__GL_SAMPLE_ALPHA_TO_ONE, SBL__GL_SAMPLE_COVERAGE, SBL__GL_SAMPLE_MASK,
    SBL__GL_DEPTH_CLAMP, SBL__GL_RASTERIZER_DISCARD, SBL__GL_FRAMEBUFFER_SRGB, SBL__GL_PRIMITIVE_RESTART,
    SBL__GL_CLIP_DISTANCE0, SBL__GL_CLIP_DISTANCE0 + 1, SBL__GL_CLIP_DISTANCE0 + 2, SBL__GL_CLIP_DISTANCE0 + 3,
    SBL__GL_CLIP_DISTANCE0 + 4, SBL__GL_CLIP_DISTANCE0 + 5, SBL__GL_CLIP_DISTANCE0 + 6, SBL__GL_CLIP_DISTANCE0 + 7,
    SBL__GL_SAMPLE_SHADING, SBL__GL_PRIMITIVE_RESTART_FIXED_INDEX
};

static int sbl__guard_switch_count(const sbl__gl *gl) {
    return SBL__COUNT(sbl__guard_switches) - !sbl__gl_at_least(gl, 40) - !sbl__gl_at_least(gl, 43);
}

/* The parameters of glPixelStore that affect 2D textures, and the values that the library works with */
static const struct { unsigned name; int value; } sbl__guard_pixel_store[] = {
    { SBL__GL_UNPACK_SWAP_BYTES, 0 }, { SBL__GL_UNPACK_ROW_LENGTH, 0 }, { SBL__GL_UNPACK_SKIP_ROWS, 0 },
    { SBL__GL_UNPACK_SKIP_PIXELS, 0 }, { SBL__GL_UNPACK_ALIGNMENT, 1 }, { SBL__GL_PACK_SWAP_BYTES, 0 },
    { SBL__GL_PACK_ROW_LENGTH, 0 }, { SBL__GL_PACK_SKIP_ROWS, 0 }, { SBL__GL_PACK_SKIP_PIXELS, 0 },
    { SBL__GL_PACK_ALIGNMENT, 1 }
};

/* The state of an image unit, in the order of the parameters of glBindImageTexture */
static const unsigned sbl__guard_image[6] = {
    SBL__GL_IMAGE_BINDING_NAME, SBL__GL_IMAGE_BINDING_LEVEL, SBL__GL_IMAGE_BINDING_LAYERED,
    SBL__GL_IMAGE_BINDING_LAYER, SBL__GL_IMAGE_BINDING_ACCESS, SBL__GL_IMAGE_BINDING_FORMAT
};

/* Buffer targets, and the names that query their bindings */
static const struct { unsigned target, query; } sbl__guard_buffers[] = {
    { SBL__GL_ARRAY_BUFFER, SBL__GL_ARRAY_BUFFER_BINDING }, { SBL__GL_TEXTURE_BUFFER, SBL__GL_TEXTURE_BUFFER },
    { SBL__GL_COPY_READ_BUFFER, SBL__GL_COPY_READ_BUFFER },
    { SBL__GL_PIXEL_PACK_BUFFER, SBL__GL_PIXEL_PACK_BUFFER_BINDING },
    { SBL__GL_PIXEL_UNPACK_BUFFER, SBL__GL_PIXEL_UNPACK_BUFFER_BINDING }
};

typedef struct sbl__guard {
    unsigned char switches[32], blend[SBL__GUARD_DRAW_BUFFERS], color_mask[SBL__GUARD_DRAW_BUFFERS][4];
    int pixel_store[16], polygon_mode[2], front_face, clamp_read, depth_mask, depth_function, clip_origin, clip_depth;
    unsigned char scissor_test[SBL__GUARD_VIEWPORTS];
    int viewport[4], scissor[4], scissors[SBL__GUARD_VIEWPORTS][4];
    float viewports[SBL__GUARD_VIEWPORTS][4];
    double depth_range[2], depth_ranges[SBL__GUARD_VIEWPORTS][2];
    int program, vertex_array, buffers[8], draw_framebuffer, read_framebuffer, active_texture;
    int textures_2d[SBL__GUARD_UNITS], textures_buffer[SBL__GUARD_UNITS], samplers[SBL__GUARD_UNITS];
    int images[SBL__GUARD_IMAGES][6];
} sbl__guard;

static void sbl__guard_save(const sbl__gl *gl, sbl__guard *g) {
    int i;
    memset(g, 0, sizeof *g);
    sbl__gl_clear_errors(gl);
    for (i = 0; i < sbl__guard_switch_count(gl); i++) g->switches[i] = gl->IsEnabled(sbl__guard_switches[i]);
    for (i = 0; i < SBL__GUARD_DRAW_BUFFERS; i++) {
        g->blend[i] = gl->IsEnabledi(SBL__GL_BLEND, (unsigned)i);
        gl->GetBooleani_v(SBL__GL_COLOR_WRITEMASK, (unsigned)i, g->color_mask[i]);
    }
    gl->GetIntegerv(SBL__GL_DEPTH_WRITEMASK, &g->depth_mask);
    gl->GetIntegerv(SBL__GL_POLYGON_MODE, g->polygon_mode);
    gl->GetIntegerv(SBL__GL_FRONT_FACE, &g->front_face);
    gl->GetIntegerv(SBL__GL_CLAMP_READ_COLOR, &g->clamp_read);
    gl->GetIntegerv(SBL__GL_DEPTH_FUNC, &g->depth_function);
    gl->GetIntegerv(SBL__GL_VIEWPORT, g->viewport);
    gl->GetIntegerv(SBL__GL_SCISSOR_BOX, g->scissor);
    gl->GetDoublev(SBL__GL_DEPTH_RANGE, g->depth_range);
    for (i = 0; gl->viewports > 1 && i < gl->viewports; i++) {
        g->scissor_test[i] = gl->IsEnabledi(SBL__GL_SCISSOR_TEST, (unsigned)i);
        gl->GetFloati_v(SBL__GL_VIEWPORT, (unsigned)i, g->viewports[i]);
        gl->GetIntegeri_v(SBL__GL_SCISSOR_BOX, (unsigned)i, g->scissors[i]);
        gl->GetDoublei_v(SBL__GL_DEPTH_RANGE, (unsigned)i, g->depth_ranges[i]);
    }
    if (gl->capabilities.available & SBL_CAPABILITY_CLIP_CONTROL) {
        gl->GetIntegerv(SBL__GL_CLIP_ORIGIN, &g->clip_origin);
        gl->GetIntegerv(SBL__GL_CLIP_DEPTH_MODE, &g->clip_depth);
    }
    for (i = 0; i < SBL__COUNT(sbl__guard_pixel_store); i++)
        gl->GetIntegerv(sbl__guard_pixel_store[i].name, &g->pixel_store[i]);
    gl->GetIntegerv(SBL__GL_CURRENT_PROGRAM, &g->program);
    gl->GetIntegerv(SBL__GL_VERTEX_ARRAY_BINDING, &g->vertex_array);
    for (i = 0; i < SBL__COUNT(sbl__guard_buffers); i++)
        gl->GetIntegerv(sbl__guard_buffers[i].query, &g->buffers[i]);
    gl->GetIntegerv(SBL__GL_DRAW_FRAMEBUFFER_BINDING, &g->draw_framebuffer);
    gl->GetIntegerv(SBL__GL_READ_FRAMEBUFFER_BINDING, &g->read_framebuffer);
    gl->GetIntegerv(SBL__GL_ACTIVE_TEXTURE, &g->active_texture);
    for (i = 0; i < SBL__GUARD_UNITS; i++) {
        gl->ActiveTexture(SBL__GL_TEXTURE0 + (unsigned)i);
        gl->GetIntegerv(SBL__GL_TEXTURE_BINDING_2D, &g->textures_2d[i]);
        gl->GetIntegerv(SBL__GL_TEXTURE_BINDING_BUFFER, &g->textures_buffer[i]);
        gl->GetIntegerv(SBL__GL_SAMPLER_BINDING, &g->samplers[i]);
    }
    for (i = 0; gl->capabilities.used & SBL_CAPABILITY_COMPUTE && i < 6 * SBL__GUARD_IMAGES; i++)
        gl->GetIntegeri_v(sbl__guard_image[i % 6], (unsigned)i / 6, &g->images[i / 6][i % 6]);
    sbl__gl_clear_errors(gl);  /* old drivers reject some of the queries with an error; the saved value is then 0 */
}

static void sbl__guard_force(const sbl__gl *gl) {
    int i;
    for (i = 0; i < sbl__guard_switch_count(gl); i++) gl->Disable(sbl__guard_switches[i]);
    gl->Enable(SBL__GL_DEPTH_CLAMP);
    for (i = 0; i < SBL__GUARD_DRAW_BUFFERS; i++) {
        gl->Disablei(SBL__GL_BLEND, (unsigned)i);
        gl->ColorMaski((unsigned)i, 1, 1, 1, 1);
    }
    gl->DepthMask(1);
    for (i = 0; i < SBL__COUNT(sbl__guard_pixel_store); i++)
        gl->PixelStorei(sbl__guard_pixel_store[i].name, sbl__guard_pixel_store[i].value);
    gl->PolygonMode(SBL__GL_FRONT_AND_BACK, SBL__GL_FILL);
    gl->ClampColor(SBL__GL_CLAMP_READ_COLOR, 0);
    gl->FrontFace(SBL__GL_CCW);
    gl->DepthFunc(SBL__GL_GREATER);
    gl->DepthRange(0, 1);
    if (gl->capabilities.available & SBL_CAPABILITY_CLIP_CONTROL)
        gl->ClipControl(SBL__GL_LOWER_LEFT, gl->capabilities.used & SBL_CAPABILITY_CLIP_CONTROL ?
                        SBL__GL_ZERO_TO_ONE : SBL__GL_NEGATIVE_ONE_TO_ONE);
    gl->BindBuffer(SBL__GL_PIXEL_PACK_BUFFER, 0);
    gl->BindBuffer(SBL__GL_PIXEL_UNPACK_BUFFER, 0);
    for (i = 0; i < SBL__GUARD_UNITS; i++) gl->BindSampler((unsigned)i, 0);
    gl->ActiveTexture(SBL__GL_TEXTURE0);  /* new textures are bound to the active unit, and the guard restores unit 0 */
}

static void sbl__guard_restore(const sbl__gl *gl, const sbl__guard *g) {
    int i;
    for (i = 0; i < sbl__guard_switch_count(gl); i++)
        (g->switches[i] ? gl->Enable : gl->Disable)(sbl__guard_switches[i]);
    for (i = 0; i < SBL__GUARD_DRAW_BUFFERS; i++) {
        const unsigned char *m = g->color_mask[i];
        (g->blend[i] ? gl->Enablei : gl->Disablei)(SBL__GL_BLEND, (unsigned)i);
        gl->ColorMaski((unsigned)i, m[0], m[1], m[2], m[3]);
    }
    gl->DepthMask((unsigned char)g->depth_mask);
    gl->PolygonMode(SBL__GL_FRONT_AND_BACK, (unsigned)g->polygon_mode[0]);
    gl->ClampColor(SBL__GL_CLAMP_READ_COLOR, (unsigned)g->clamp_read);
    gl->FrontFace((unsigned)g->front_face);
    gl->DepthFunc((unsigned)g->depth_function);
    gl->DepthRange(g->depth_range[0], g->depth_range[1]);
    gl->Viewport(g->viewport[0], g->viewport[1], g->viewport[2], g->viewport[3]);
    gl->Scissor(g->scissor[0], g->scissor[1], g->scissor[2], g->scissor[3]);
    for (i = 0; gl->viewports > 1 && i < gl->viewports; i++) {
        (g->scissor_test[i] ? gl->Enablei : gl->Disablei)(SBL__GL_SCISSOR_TEST, (unsigned)i);
        gl->ViewportIndexedfv((unsigned)i, g->viewports[i]);
        gl->ScissorIndexedv((unsigned)i, g->scissors[i]);
        gl->DepthRangeIndexed((unsigned)i, g->depth_ranges[i][0], g->depth_ranges[i][1]);
    }
    if (gl->capabilities.available & SBL_CAPABILITY_CLIP_CONTROL)
        gl->ClipControl((unsigned)g->clip_origin, (unsigned)g->clip_depth);
    for (i = 0; i < SBL__COUNT(sbl__guard_pixel_store); i++)
        gl->PixelStorei(sbl__guard_pixel_store[i].name, g->pixel_store[i]);
    for (i = 0; i < SBL__GUARD_UNITS; i++) {
        gl->ActiveTexture(SBL__GL_TEXTURE0 + (unsigned)i);
        gl->BindTexture(SBL__GL_TEXTURE_2D, (unsigned)g->textures_2d[i]);
        gl->BindTexture(SBL__GL_TEXTURE_BUFFER, (unsigned)g->textures_buffer[i]);
        gl->BindSampler((unsigned)i, (unsigned)g->samplers[i]);
    }
    for (i = 0; gl->capabilities.used & SBL_CAPABILITY_COMPUTE && i < SBL__GUARD_IMAGES; i++) {
        const int *m = g->images[i];
        gl->BindImageTexture((unsigned)i, (unsigned)m[0], m[1], (unsigned char)m[2], m[3], (unsigned)m[4],
                             (unsigned)m[5]);
    }
    gl->ActiveTexture((unsigned)g->active_texture);
    gl->UseProgram((unsigned)g->program);
    gl->BindVertexArray((unsigned)g->vertex_array);
    for (i = 0; i < SBL__COUNT(sbl__guard_buffers); i++)
        gl->BindBuffer(sbl__guard_buffers[i].target, (unsigned)g->buffers[i]);
    gl->BindFramebuffer(SBL__GL_DRAW_FRAMEBUFFER, (unsigned)g->draw_framebuffer);
    gl->BindFramebuffer(SBL__GL_READ_FRAMEBUFFER, (unsigned)g->read_framebuffer);
}

/* ======================================================================================================== >>records
   Constants and records that C and the shaders share. C fills an array of structs; shaders read it from a table.

   SBL__NAME(X) lists the fields of a record. From it, SBL__RECORD defines the struct sbl__name and sbl__name_record.
   sbl__write_record then writes GLSL: the declaration of the table's sampler, and a function for each field, such as

       vec3 sbl_object_albedo(int i) { return uintBitsToFloat(sbl_fetch(sbl_objects, 5 * i + 0).xyz); }

   The size of the struct must be a multiple of 16 bytes, the size of a texel. No field may cross a texel boundary. */

typedef enum sbl__kind { SBL__FLOAT, SBL__VEC3, SBL__UINT, SBL__UVEC2, SBL__UVEC3, SBL__UVEC4 } sbl__kind;

/* word: offset in the record, in 32-bit words */
typedef struct sbl__field { const char *name; sbl__kind kind; int word; } sbl__field;

typedef struct sbl__record {
    const char *name;          /* prefix of the GLSL functions' names */
    const char *sampler;       /* name of the table's sampler */
    const char *declaration;   /* GLSL declaration of the sampler; "" if another record of the same table declares it */
    const char *first;         /* name of the uniform that holds the first record's texel number; NULL: it is 0 */
    int texels;                /* number of texels that one struct takes in a table */
    const sbl__field *fields;
    int field_count;
} sbl__record;

#define SBL__FIELD_FLOAT(name) float name;
#define SBL__FIELD_VEC3(name) float name[3];
#define SBL__FIELD_UINT(name) uint32_t name;
#define SBL__FIELD_UVEC2(name) uint32_t name[2];
#define SBL__FIELD_UVEC3(name) uint32_t name[3];
#define SBL__FIELD_UVEC4(name) uint32_t name[4];
#define SBL__FIELD_MEMBER(type, kind, name) SBL__FIELD_##kind(name)
#define SBL__FIELD_ENTRY(type, kind, name) { #name, SBL__##kind, (int)(offsetof(type, name) / 4) },

#define SBL__RECORD(type, list, name, sampler, declaration, first) \
    typedef struct type { list(SBL__FIELD_MEMBER) } type; \
    static const sbl__field type##_fields[] = { list(SBL__FIELD_ENTRY) }; \
    static const sbl__record type##_record = { name, sampler, declaration, first, (int)(sizeof(type) / 16), \
                                               type##_fields, SBL__COUNT(type##_fields) };

/* GLSL declarations of samplers: for tables that grow with the scene (see tables.glsl), and for other tables */
#define SBL__SCENE_TABLE(sampler) "uniform sbl_Texels " sampler ";\n"
#define SBL__BUFFER_TABLE(sampler) "uniform usamplerBuffer " sampler ";\n"

#define SBL__TEXELS_SHIFT 12       /* log2 of TEXELS_ACROSS; GL 3.3 guarantees 1024 texels, all known drivers 4096 */
#define SBL__TEXELS_ACROSS (1 << SBL__TEXELS_SHIFT)  /* width of tables that are 2D textures, in texels */
#define SBL__STACK 64              /* size of the stack with which a ray traverses the hierarchy, in nodes */
#define SBL__LAMPS 256             /* maximum number of entries (lamps plus clusters) of a look in lamps.glsl */
#define SBL__LAMP_PASSES 8         /* maximum number of passes into which lamps.glsl divides a part of a look's rays */
#define SBL__TEXTURE_SRGB 1u       /* kind of a texture: 8-bit sRGB */
#define SBL__TEXTURE_FLOAT 2u      /* kind of a texture: 16-bit float */
#define SBL__TEXTURE_KIND 3u       /* mask of the kind; 0 means that there is no texture */
#define SBL__TEXTURE_CLAMPS 4u     /* flag: coordinates are clamped; otherwise the texture repeats */
#define SBL__LEAF 0x80000000u      /* LEAF, ENTER: references, see sbl__node; LEAVE, END: only in rays' stacks */
#define SBL__ENTER 0xc0000000u
#define SBL__LEAVE 0xd0000000u
#define SBL__END 0xffffffffu
#define SBL__CHILD_NUMBER 0x0fffffffu
#define SBL__LAMP_TRIANGLE 0u      /* kinds of lamps, see >>lamps */
#define SBL__LAMP_NEAR_LIGHT 1u
#define SBL__LAMP_FAR_LIGHT 2u
#define SBL__LAMP_SKY_TEXEL 3u
#define SBL__LAMP_KIND_SHIFT 30
#define SBL__FAR_NODE 0x80000000u  /* flag in sbl__lamp_node.beyond: all lamps of the node are at infinity */
#define SBL__PATCH_BACK 1u         /* bits of a patch word, see sbl__patch_word */
#define SBL__PATCH_FLAT 2u
#define SBL__PATCH_AXIS_SHIFT 2
#define SBL__PATCH_NEAR 16u        /* flag: for rays shorter than 1 / NEAR_PART of a level-0 cell's length */
#define SBL__PATCH_LEVEL 32u       /* a patch word contains the cell's level (two bits) times this */
#define SBL__PATCH_SHIFT 7
#define SBL__NEAR_PART 2
#define SBL__SLOT_TRIES 64         /* largest number of slots that a search in the hash grid visits */
#define SBL__CELL_CUT 0x80000000u  /* flag of a reference in the store: it leads to a cut, not to a leaf */
#define SBL__CELL_DEPTH 8          /* largest number of cuts between a cell and a leaf */
#define SBL__LEVELS 3              /* number of cell sizes; new surfaces get larger cells as the store fills up */
#define SBL__LEVEL_SHIFT 2         /* cells of level n + 1 are 2^this times as long as cells of level n */
#define SBL__CAST_NUMBERS 1048576  /* cast.glsl stores a triangle's number n as two floats, n % this and n / this */
#define SBL__GUIDE_RINGS 16        /* rings of a guide's histogram, see >>guide */
#define SBL__GUIDE_SECTORS 32      /* sectors of each ring */
#define SBL__GUIDE_TEXELS 66       /* texels of a guide; each texel holds eight values */
#define SBL__GUIDES_ACROSS 15      /* guides in a row of the guides' texture */
#define SBL__LOOK_NUMBER 0x3ffu    /* mask of the look's number in sbl__look.which */
#define SBL__LOOK_GUIDE_SHIFT 10   /* the guide's number is which >> this */
#define SBL__RESULTS_WIDTH 1024    /* width of the textures of a job's results, texels */
#define SBL__HASH_FACTOR 0x9e3779b1u
#define SBL__HASH_SHIFT 15
#define SBL__RGBE_BIAS 128         /* offset of the exponent that sbl__rgbe stores */
#define SBL__RGBE_BITS 8           /* bits of each of the three mantissas that sbl__rgbe stores */

#define SBL__UNBOUNDED 1e30f           /* length of a ray without a limit; distance of a hit that does not exist */
#define SBL__FRACTIONS 16777216.0      /* 2^24: a 32-bit fraction becomes a float from 0 to 1 by division of
                                          its upper 24 bits, as many as a float holds, by this */
#define SBL__COLOR_MOST 65535.0f       /* integer that stands for 1 in a vertex colour */
#define SBL__GUIDE_STEPS 65536.0       /* 2^16: a guide divides 0 .. 1 into intervals, and stores where each begins
                                          as a 16-bit integer: position * this */
#define SBL__HARMONIC_0 0.28209479f    /* spherical harmonic of band 0: 1 / sqrt(4 pi) */
#define SBL__HARMONIC_1 0.48860251f    /* factor of y, z and x in the spherical harmonics of band 1: sqrt(3 / (4 pi)) */
#define SBL__BOUNCE_ALBEDO 0.98f       /* upper limit of the albedo when >>bounce computes the store; where sensors see
                                          a surface, the store's R is multiplied by the unlimited albedo */
#define SBL__SKY_LEAST 1e-37f          /* smallest sky radiance that may be a divisor */
#define SBL__CELL_MOST 2e9f            /* largest coordinate of a cell in the grid */
#define SBL__NORMAL_LEAST 1e-12        /* squared length up to which an interpolated normal is replaced by the face's */
#define SBL__GRAZING 0.01              /* smallest cosine that a shading normal may have with the direction to the
                                          viewer or, at sites of >>vertices, with the face's normal */
#define SBL__BELONGS_COSINE 0.8f       /* sbl_belongs is 0 up to this cosine of the angle between two points' normals */
#define SBL__BELONGS_TURN 0.2f         /* from BELONGS_COSINE + this on, the angle does not reduce sbl_belongs */
#define SBL__BELONGS_OFF 8.0f          /* sbl_belongs falls to 0 while this * (larger distance of one point from the
                                          other's plane) / (distance of the points) rises from 1 to 2 */
#define SBL__FILTER_VISIBLE 0.0025f    /* the filter counts this share of the light as noise, as it is invisible */
#define SBL__FILTER_FALL 0.25          /* the filter's weights are exp(-this * (difference / noise)^2) */
#define SBL__DIVISOR_LEAST 1e-30f      /* lower limit of divisors that may be 0 */
#define SBL__VIEW_DEPTH 1e-6f          /* depth in sensors' views is this / view-space depth in scene extents: reversed,
                                          without a far plane */
#define SBL__OFFSET 1.5e-6f            /* distance of a sensor from its surface: a share of the scene's extent (if views
                                          are rasterised, for the precision of the depth buffer) or of the triangle's
                                          reach (if rays are traced, see surface.glsl). Float rounding needs more than
                                          a sixth of it: at 2.5e-7 and below, sensors on a sphere see the sphere */

/* Constants that shaders get as #define SBL_name, with the text of SBL__name or the value of SBL_MATERIAL_name */
#define SBL__SHARED_CONSTANTS(X) \
    X(TEXELS_SHIFT) X(TEXELS_ACROSS) X(STACK) X(LAMPS) X(LAMP_PASSES) X(LAMP_KIND_SHIFT) \
    X(PATCH_AXIS_SHIFT) X(NEAR_PART) X(SLOT_TRIES) X(CELL_DEPTH) X(LEVELS) X(LEVEL_SHIFT) X(CAST_NUMBERS) \
    X(GUIDE_RINGS) X(GUIDE_SECTORS) X(GUIDE_TEXELS) X(GUIDES_ACROSS) X(LOOK_GUIDE_SHIFT) X(HASH_SHIFT) X(RGBE_BIAS) \
    X(RGBE_BITS) X(TEXTURE_SRGB) X(TEXTURE_KIND) X(TEXTURE_CLAMPS) X(LEAF) X(ENTER) X(LEAVE) X(END) X(CHILD_NUMBER) \
    X(LAMP_TRIANGLE) X(LAMP_NEAR_LIGHT) X(LAMP_FAR_LIGHT) X(LAMP_SKY_TEXEL) X(FAR_NODE) X(RESULTS_WIDTH) \
    X(PATCH_BACK) X(PATCH_NEAR) X(PATCH_FLAT) X(PATCH_LEVEL) X(CELL_CUT) X(LOOK_NUMBER) X(HASH_FACTOR) \
    X(PI) X(LUMINANCE_WEIGHTS) X(UNBOUNDED) X(FRACTIONS) X(COLOR_MOST) X(GUIDE_STEPS) X(HARMONIC_0) X(HARMONIC_1) \
    X(BOUNCE_ALBEDO) X(SKY_LEAST) X(CELL_MOST) X(NORMAL_LEAST) X(GRAZING) X(BELONGS_COSINE) X(BELONGS_TURN) \
    X(BELONGS_OFF) X(FILTER_VISIBLE) X(FILTER_FALL) X(DIVISOR_LEAST) X(VIEW_DEPTH) X(OFFSET)
#define SBL__SHARED_FLAGS(X) X(ONE_SIDED_EMISSION) X(HIDDEN_FROM_CAMERA) X(HIDDEN_FROM_SENSORS) X(NO_SENSORS)

#define SBL__PRELUDE_MOST 16384    /* size of the text that precedes the files of a shader, in characters */

/* Appends to a string of `length` characters in an array of SBL__PRELUDE_MOST, and drops what does not fit.
   Returns the new length. */
static size_t sbl__write(char *text, size_t length, const char *format, ...) {
    va_list arguments;
    int more;
    va_start(arguments, format);
    more = vsnprintf(text + length, SBL__PRELUDE_MOST - length, format, arguments);
    va_end(arguments);
    return SBL__MIN(length + (size_t)SBL__MAX(more, 0), SBL__PRELUDE_MOST - 1);
}

static size_t sbl__write_constants(char *text, size_t length) {
#define SBL__X(name) length = sbl__write(text, length, "#define SBL_" #name " %uu\n", (unsigned)SBL_MATERIAL_##name);
    SBL__SHARED_FLAGS(SBL__X)
#undef SBL__X
    /* Writes the text of the macros, because printf would round floats, and write commas in some locales. */
#define SBL__TEXT(...) #__VA_ARGS__
#define SBL__TEXT_OF(...) SBL__TEXT(__VA_ARGS__)
#define SBL__X(name) length = sbl__write(text, length, "#define SBL_" #name " %s\n", SBL__TEXT_OF(SBL__##name));
    SBL__SHARED_CONSTANTS(SBL__X)
#undef SBL__X
    return length;
}

static size_t sbl__write_record(char *text, size_t length, const sbl__record *r) {
    static const struct { const char *type; int components, is_float; } kinds[] = {  /* in the order of sbl__kind */
        { "float", 1, 1 }, { "vec3", 3, 1 }, { "uint", 1, 0 }, { "uvec2", 2, 0 }, { "uvec3", 3, 0 }, { "uvec4", 4, 0 }
    };
    int i;
    length = sbl__write(text, length, "%s", r->declaration);
    if (r->first) length = sbl__write(text, length, "uniform int %s;\n", r->first);
    for (i = 0; i < r->field_count; i++) {
        const sbl__field *f = &r->fields[i];
        const char *type = kinds[f->kind].type, *fetch = strstr(r->declaration, "Buffer") ? "texelFetch" : "sbl_fetch";
        length = sbl__write(text, length, "%s %s_%s(int i) { return %s(%s(%s, %s%s%d * i + %d).%.*s); }\n", type,
                            r->name, f->name, kinds[f->kind].is_float ? "uintBitsToFloat" : "", fetch, r->sampler,
                            r->first ? r->first : "", r->first ? " + " : "", r->texels, f->word / 4,
                            kinds[f->kind].components, &"xyzw"[f->word % 4]);
    }
    return length;
}

/* ======================================================================================================== >>device
   GL objects (textures, buffers, targets, programs), draws and reads, and the clock that divides work into submissions.
   Functions that create an object log an error if they fail. Functions that delete an object accept an empty one. */

typedef struct sbl__texture { unsigned id; int width, height; unsigned format; size_t bytes; } sbl__texture;
typedef struct sbl__buffer { unsigned id; size_t bytes; } sbl__buffer;

/* A framebuffer with `count` colour textures and, for some passes, a depth texture. */
typedef struct sbl__target { unsigned id; int width, height, count; unsigned textures[6], formats[6]; } sbl__target;

typedef struct sbl__program { const struct sbl__recipe *recipe; unsigned features, id; } sbl__program;

#define SBL__PROGRAMS_MOST 256  /* at least the number of all variants of all recipes; test_steps.c counts them */

typedef struct sbl__device {
    sbl__base *base;
    sbl__gl gl;
    unsigned features;       /* features that depend on the driver: SBL__WRITE_DEPTH, SBL__COMPUTE */
    unsigned empty_array;    /* vertex array without attributes */
    sbl__program programs[SBL__PROGRAMS_MOST];  /* programs compiled so far */
    sbl_programs compiled;   /* number of programs compiled so far, and seconds spent compiling them */
    unsigned program;        /* GL name of the program in use */
    int unit;                /* next free texture unit of the program in use */
    int workgroup;           /* invocations in a workgroup of a compute shader */
    int lot;                 /* invocations that occupy the whole device; fewer take as long as this number */
} sbl__device;

/* Makes *name the name of a new GL object if it is 0. Returns 1 on success. If GL gives no name, logs an error and
   returns 0; the caller must then not bind *name, because the name 0 belongs to the host's default objects. */
static int sbl__name_make(const sbl__device *d, void (SBL__GLAPI *generate)(int, unsigned *), unsigned *name) {
    if (!*name) generate(1, name);
    if (!*name) sbl__log(d->base, SBL_LOG_ERROR, SBL_LOG_ITEM_GL_ERROR, "GL gave no name while %s", d->gl.doing);
    return *name != 0;
}

static void sbl__gpu_account(sbl__base *base, size_t before, size_t after) {
    base->memory.gpu_bytes = base->memory.gpu_bytes - before + after;
    if (base->memory.gpu_bytes > base->memory.gpu_peak_bytes) base->memory.gpu_peak_bytes = base->memory.gpu_bytes;
}

/* bytes: size of a texel */
typedef struct sbl__format { unsigned internal, format, type; size_t bytes; } sbl__format;

static const sbl__format sbl__formats[] = {
    { SBL__GL_R32F, SBL__GL_RED, SBL__GL_FLOAT, 4 },
    { SBL__GL_R32UI, SBL__GL_RED_INTEGER, SBL__GL_UNSIGNED_INT, 4 },
    { SBL__GL_RG32F, SBL__GL_RG, SBL__GL_FLOAT, 8 },
    { SBL__GL_RG32UI, SBL__GL_RG_INTEGER, SBL__GL_UNSIGNED_INT, 8 },
    { SBL__GL_RGBA16F, SBL__GL_RGBA, SBL__GL_HALF_FLOAT, 8 },
    { SBL__GL_RGBA32F, SBL__GL_RGBA, SBL__GL_FLOAT, 16 },
    { SBL__GL_RGBA32UI, SBL__GL_RGBA_INTEGER, SBL__GL_UNSIGNED_INT, 16 },
    { SBL__GL_SRGB8_ALPHA8, SBL__GL_RGBA, SBL__GL_UNSIGNED_BYTE, 4 },
    { SBL__GL_DEPTH_COMPONENT32F, SBL__GL_DEPTH_COMPONENT, SBL__GL_FLOAT, 4 }
};

static const sbl__format *sbl__format_of(unsigned internal) {
    const sbl__format *f = sbl__formats;
    while (f->internal != internal) f++;
    return f;
}

/* >>device: textures and buffers */

static void sbl__texture_delete(const sbl__device *d, sbl__texture *t) {
    if (t->id) d->gl.DeleteTextures(1, &t->id);
    sbl__gpu_account(d->base, t->bytes, 0);
    memset(t, 0, sizeof *t);
}

/* Gives a texture this size and format, with undefined texels. Does nothing if it has this size and format already. */
static sbl_result sbl__texture_make(const sbl__device *d, sbl__texture *t, int width, int height, unsigned format) {
    const sbl__gl *gl = &d->gl;
    const sbl__format *f = sbl__format_of(format);
    sbl_result result;
    if (t->id && t->width == width && t->height == height && t->format == format) return SBL_SUCCESS;
    sbl__texture_delete(d, t);
    if (!sbl__name_make(d, gl->GenTextures, &t->id)) return SBL_ERROR_GL;
    gl->BindTexture(SBL__GL_TEXTURE_2D, t->id);
    gl->TexImage2D(SBL__GL_TEXTURE_2D, 0, (int)format, width, height, 0, f->format, f->type, NULL);
    gl->TexParameteri(SBL__GL_TEXTURE_2D, SBL__GL_TEXTURE_MIN_FILTER, SBL__GL_NEAREST);
    gl->TexParameteri(SBL__GL_TEXTURE_2D, SBL__GL_TEXTURE_MAG_FILTER, SBL__GL_NEAREST);
    gl->TexParameteri(SBL__GL_TEXTURE_2D, SBL__GL_TEXTURE_WRAP_S, SBL__GL_CLAMP_TO_EDGE);  /* hosts may sample it */
    gl->TexParameteri(SBL__GL_TEXTURE_2D, SBL__GL_TEXTURE_WRAP_T, SBL__GL_CLAMP_TO_EDGE);
    gl->TexParameteri(SBL__GL_TEXTURE_2D, SBL__GL_TEXTURE_MAX_LEVEL, 0);
    result = sbl__gl_check(gl);
    if (result != SBL_SUCCESS) { sbl__texture_delete(d, t); return result; }
    t->width = width; t->height = height; t->format = format;
    t->bytes = (size_t)width * (size_t)height * f->bytes;
    sbl__gpu_account(d->base, 0, t->bytes);
    return SBL_SUCCESS;
}

/* Writes rows of texels. from: texels in the layout of the texture's format */
static sbl_result sbl__texture_write(const sbl__device *d, const sbl__texture *t, int row, int rows, const void *from) {
    const sbl__format *f = sbl__format_of(t->format);
    d->gl.BindTexture(SBL__GL_TEXTURE_2D, t->id);
    d->gl.TexSubImage2D(SBL__GL_TEXTURE_2D, 0, 0, row, t->width, rows, f->format, f->type, from);
    return sbl__gl_check(&d->gl);
}

static void sbl__buffer_delete(const sbl__device *d, sbl__buffer *b) {
    if (b->id) d->gl.DeleteBuffers(1, &b->id);
    sbl__gpu_account(d->base, b->bytes, 0);
    memset(b, 0, sizeof *b);
}

/* Gives a buffer this size and content. data: NULL leaves the content undefined. usage: as in glBufferData */
static sbl_result sbl__buffer_make(const sbl__device *d, sbl__buffer *b, size_t bytes, const void *data,
                                   unsigned usage) {
    const sbl__gl *gl = &d->gl;
    sbl_result result;
    if (!sbl__name_make(d, gl->GenBuffers, &b->id)) return SBL_ERROR_GL;
    gl->BindBuffer(SBL__GL_ARRAY_BUFFER, b->id);
    gl->BufferData(SBL__GL_ARRAY_BUFFER, (ptrdiff_t)SBL__MAX(bytes, 16), data && bytes >= 16 ? data : NULL, usage);
    if (data && bytes && bytes < 16) gl->BufferSubData(SBL__GL_ARRAY_BUFFER, 0, (ptrdiff_t)bytes, data);
    result = sbl__gl_check(gl);
    if (result != SBL_SUCCESS) { sbl__buffer_delete(d, b); return result; }
    sbl__gpu_account(d->base, b->bytes, bytes);
    b->bytes = bytes;
    return SBL_SUCCESS;
}

/* Writes the data of a batch to a buffer. room: bytes of the largest batch. The buffer always has this size, so that
   the memory in use does not depend on the pace. */
static sbl_result sbl__buffer_stream(const sbl__device *d, sbl__buffer *b, size_t room, const void *data,
                                     size_t bytes) {
    const sbl_result result = sbl__buffer_make(d, b, room, NULL, SBL__GL_STREAM_DRAW);
    if (result != SBL_SUCCESS) return result;
    d->gl.BufferSubData(SBL__GL_ARRAY_BUFFER, 0, (ptrdiff_t)bytes, data);
    return sbl__gl_check(&d->gl);
}

static void sbl__buffer_write(const sbl__device *d, const sbl__buffer *b, size_t offset, size_t bytes,
                              const void *data) {
    d->gl.BindBuffer(SBL__GL_ARRAY_BUFFER, b->id);
    d->gl.BufferSubData(SBL__GL_ARRAY_BUFFER, (ptrdiff_t)offset, (ptrdiff_t)bytes, data);
}

/* A buffer that shaders read as a buffer texture. If one of the scene's tables exceeds the driver's limit of buffer
   textures, all tables of the scene are copied to 2D textures (`wide`). sbl_fetch in tables.glsl reads both kinds. */
typedef struct sbl__table { sbl__buffer buffer; sbl__texture texels; } sbl__table;

static void sbl__table_delete(const sbl__device *d, sbl__table *t) {
    sbl__texture_delete(d, &t->texels);
    sbl__buffer_delete(d, &t->buffer);
}

/* Makes the content of the table's buffer visible to shaders. wide: copies it to a 2D texture */
static sbl_result sbl__table_attach(const sbl__device *d, sbl__table *t, unsigned format, int wide) {
    const sbl__gl *gl = &d->gl;
    const sbl__format *f = sbl__format_of(format);
    const size_t texels = t->buffer.bytes / f->bytes;
    const int rows = (int)(texels / SBL__TEXELS_ACROSS), rest = (int)(texels % SBL__TEXELS_ACROSS);
    sbl_result result;
    if (!wide) {
        if (!sbl__name_make(d, gl->GenTextures, &t->texels.id)) return SBL_ERROR_GL;
        gl->BindTexture(SBL__GL_TEXTURE_BUFFER, t->texels.id);
        gl->TexBuffer(SBL__GL_TEXTURE_BUFFER, format, t->buffer.id);
        return sbl__gl_check(gl);
    }
    result = sbl__texture_make(d, &t->texels, SBL__TEXELS_ACROSS, rows + 1, format);
    if (result != SBL_SUCCESS) return result;
    gl->BindTexture(SBL__GL_TEXTURE_2D, t->texels.id);
    gl->BindBuffer(SBL__GL_PIXEL_UNPACK_BUFFER, t->buffer.id);
    if (rows) gl->TexSubImage2D(SBL__GL_TEXTURE_2D, 0, 0, 0, SBL__TEXELS_ACROSS, rows, f->format, f->type, NULL);
    if (rest) gl->TexSubImage2D(SBL__GL_TEXTURE_2D, 0, 0, rows, rest, 1, f->format, f->type,
                                (const void *)((uintptr_t)rows * SBL__TEXELS_ACROSS * f->bytes));
    gl->BindBuffer(SBL__GL_PIXEL_UNPACK_BUFFER, 0);
    return sbl__gl_check(gl);
}

/* >>device: targets */

static void sbl__target_delete(const sbl__device *d, sbl__target *t) {
    if (t->id) d->gl.DeleteFramebuffers(1, &t->id);
    memset(t, 0, sizeof *t);
}

/* Attaches `count` textures of the same size to a target, and a depth texture if `depth` is not NULL. Creates the
   target if it does not exist. */
static sbl_result sbl__target_make(const sbl__device *d, sbl__target *t, const sbl__texture *colors, int count,
                                   const sbl__texture *depth) {
    const sbl__gl *gl = &d->gl;
    unsigned buffers[6], status;
    sbl_result result;
    int i;
    if (!sbl__name_make(d, gl->GenFramebuffers, &t->id)) return SBL_ERROR_GL;
    gl->BindFramebuffer(SBL__GL_DRAW_FRAMEBUFFER, t->id);
    for (i = 0; i < count; i++) {
        buffers[i] = SBL__GL_COLOR_ATTACHMENT0 + (unsigned)i;
        gl->FramebufferTexture2D(SBL__GL_DRAW_FRAMEBUFFER, buffers[i], SBL__GL_TEXTURE_2D, colors[i].id, 0);
        t->textures[i] = colors[i].id;
        t->formats[i] = colors[i].format;
    }
    if (depth) gl->FramebufferTexture2D(SBL__GL_DRAW_FRAMEBUFFER, SBL__GL_DEPTH_ATTACHMENT, SBL__GL_TEXTURE_2D,
                                        depth->id, 0);
    gl->DrawBuffers(count, buffers);
    status = gl->CheckFramebufferStatus(SBL__GL_DRAW_FRAMEBUFFER);
    result = sbl__gl_check(gl);
    if (result == SBL_SUCCESS && status != SBL__GL_FRAMEBUFFER_COMPLETE) {
        sbl__log(d->base, SBL_LOG_ERROR, SBL_LOG_ITEM_FRAMEBUFFER, "framebuffer status 0x%04x while %s; the driver "
                 "cannot render to that format", status, gl->doing);
        result = SBL_ERROR_GL;
    }
    t->count = count;
    t->width = colors->width;
    t->height = colors->height;
    return result;
}

/* Reads rows of a colour attachment. out: uint32_t components if the format has 32-bit integers, otherwise floats */
static sbl_result sbl__target_read(const sbl__device *d, const sbl__target *t, int attachment, int row, int rows,
                                   void *out) {
    const sbl__gl *gl = &d->gl;
    const sbl__format *f = sbl__format_of(t->formats[attachment]);
    const unsigned type = f->type == SBL__GL_UNSIGNED_INT ? SBL__GL_UNSIGNED_INT : SBL__GL_FLOAT;
    gl->BindFramebuffer(SBL__GL_READ_FRAMEBUFFER, t->id);
    gl->ReadBuffer(SBL__GL_COLOR_ATTACHMENT0 + (unsigned)attachment);
    gl->ReadPixels(0, row, t->width, rows, f->format, type, out);
    return sbl__gl_check(gl);
}

/* >>device: programs. A recipe names the shaders of a program (see shaders_embedded), the records that they read, and
   the features that make variants of it. A variant is compiled when it is first used. */

enum {
    SBL__TEXTURED = 1 << 0,     /* the scene has textures, cutouts or vertex colours */
    SBL__WIDE = 1 << 1,         /* the scene's tables are 2D textures, see sbl__table */
    SBL__VIEWS = 1 << 2,        /* also test rays towards lamps against views: only views show what the host draws */
    SBL__INSPECT = 1 << 3,      /* lamps.glsl writes each ray, for sbl_inspect_sensor */
    SBL__WRITE_DEPTH = 1 << 4,  /* shaders write depth, because the driver has no clip control */
    SBL__COMPUTE = 1 << 5,      /* use compute shaders in recipes that allow them, see sbl__invoke */
    SBL__BOUNCED = 1 << 6,      /* shaders read bounced light from the store */
    SBL__MIXED = 1 << 7,        /* some lamp is not a triangle, or there are more than SBL__LAMPS lamps */
    SBL__CUTOUTS = 1 << 8,      /* some materials have holes */
    SBL__GUIDED = 1 << 9,       /* guides choose the directions of rays, see >>guide */
    SBL__LIGHTMAP = 1 << 10,    /* pixels are texels of an atlas; otherwise they belong to a camera */
    SBL__DIRECTIONAL = 1 << 11, /* also output harmonics of the radiance, for SBL_CHANNEL_SH_0 to SBL_CHANNEL_SH_3 */
    SBL__DISPLAY = 1 << 12,     /* also output what a screen shows, for SBL_CHANNEL_DISPLAY */
    SBL__FEATURES = 13
};

#define SBL__SHADERS_MOST 12

typedef struct sbl__recipe {
    const char *name;
    const char *const *vertex[SBL__SHADERS_MOST];    /* files of the vertex shader, joined in this order */
    const char *const *fragment[SBL__SHADERS_MOST];  /* files of the fragment shader or compute shader */
    const sbl__record *records[SBL__SHADERS_MOST];   /* records that the shaders read */
    unsigned features;                               /* the features that make variants; each doubles their number */
} sbl__recipe;

#define SBL__LINES_MOST 1500  /* largest number of lines of a shader */

/* >>glsl tables: shaders_embedded/tables.glsl, copied by scripts/embed_shaders */
static const char *const sbl__glsl_tables[] = {
"// Begins every shader. The #defines of the program's features and of the constants that C shares precede it; the\n",
"// functions that read records follow it (see >>records in sbl.h). Tables that grow with the scene are buffer\n",
"// textures or, if they exceed the driver's limit of buffer textures, 2D textures (see sbl__table_attach).\n",
"#ifdef SBL_WIDE\n",
"#define sbl_Texels usampler2D\n",
"#define sbl_fetch(texels, i) texelFetch(texels, ivec2((i) & (SBL_TEXELS_ACROSS - 1), (i) >> SBL_TEXELS_SHIFT), 0)\n",
"#else\n",
"#define sbl_Texels usamplerBuffer\n",
"#define sbl_fetch(texels, i) texelFetch(texels, i)\n",
"#endif\n",
"\n",
"// Software renderers execute both branches of an if, and the body of a loop at least once, but they leave a loop\n",
"// when no lane is in it. Expensive code that is rarely needed is therefore a loop that may have 0 turns, or it\n",
"// depends on a feature.\n",
0 };
/* <<glsl */

/* Compiles a shader and hands it to a program. prelude: text that precedes the recipe's files */
static sbl_result sbl__shader_make(const sbl__device *d, const sbl__program *program, unsigned type,
                                   const char *prelude) {
    const sbl__gl *gl = &d->gl;
    const sbl__recipe *recipe = program->recipe;
    const char *const *const *shaders = type == SBL__GL_VERTEX_SHADER ? recipe->vertex : recipe->fragment;
    const unsigned id = gl->CreateShader(type);
    const char *lines[SBL__LINES_MOST];
    char text[400] = "";
    int count = 0, ok = 0, shader, line;
    lines[count++] = type == SBL__GL_COMPUTE_SHADER ? "#version 430 core\n" : "#version 330 core\n";
    lines[count++] = prelude;
    for (shader = 0; shader < SBL__SHADERS_MOST && shaders[shader]; shader++)
        for (line = 0; shaders[shader][line] && count < SBL__LINES_MOST; line++) lines[count++] = shaders[shader][line];
    if (id) {
        gl->ShaderSource(id, count, lines, NULL);
        gl->CompileShader(id);
        gl->GetShaderiv(id, SBL__GL_COMPILE_STATUS, &ok);
        if (!ok) gl->GetShaderInfoLog(id, (int)sizeof text - 1, NULL, text);
        gl->AttachShader(program->id, id);
        gl->DeleteShader(id);  /* GL keeps it until the program is deleted */
    }
    if (ok) return SBL_SUCCESS;
    sbl__log(d->base, SBL_LOG_ERROR, SBL_LOG_ITEM_SHADER_COMPILE, "the driver refuses the shader \"%s\": %s",
             recipe->name, text);
    return SBL_ERROR_GL;
}

/* Compiles and links a program, and sets program->id. */
static sbl_result sbl__program_link(const sbl__device *d, sbl__program *program, const char *prelude) {
    const sbl__gl *gl = &d->gl;
    const int compute = (program->features & SBL__COMPUTE) != 0;
    const unsigned last = compute ? SBL__GL_COMPUTE_SHADER : SBL__GL_FRAGMENT_SHADER;
    sbl_result result = SBL_SUCCESS;
    char text[400] = "";
    int ok = 0;
    program->id = gl->CreateProgram();
    if (program->id) {
        if (!compute) result = sbl__shader_make(d, program, SBL__GL_VERTEX_SHADER, prelude);
        if (result == SBL_SUCCESS) result = sbl__shader_make(d, program, last, prelude);
        if (result != SBL_SUCCESS) return result;
        gl->LinkProgram(program->id);
        gl->GetProgramiv(program->id, SBL__GL_LINK_STATUS, &ok);
        if (!ok) gl->GetProgramInfoLog(program->id, (int)sizeof text - 1, NULL, text);
    }
    if (ok) return SBL_SUCCESS;
    sbl__log(d->base, SBL_LOG_ERROR, SBL_LOG_ITEM_SHADER_LINK, "the driver does not link the program \"%s\": %s",
             program->recipe->name, text);
    return SBL_ERROR_GL;
}

/* Checks that a program reads no more textures than there are texture units. */
static sbl_result sbl__program_check_textures(const sbl__device *d, unsigned program, const char *name) {
    const sbl__gl *gl = &d->gl;
    int uniforms = 0, textures = 0, i;
    gl->GetProgramiv(program, SBL__GL_ACTIVE_UNIFORMS, &uniforms);
    for (i = 0; i < uniforms; i++) {
        char text[64];
        int length = 0, size = 0;
        unsigned type = 0;
        gl->GetActiveUniform(program, (unsigned)i, (int)sizeof text, &length, &size, &type, text);
        if (type == SBL__GL_SAMPLER_2D || type == SBL__GL_UNSIGNED_INT_SAMPLER_2D ||
            type == SBL__GL_UNSIGNED_INT_SAMPLER_BUFFER) textures += size;
    }
    if (textures <= gl->units) return SBL_SUCCESS;
    sbl__log(d->base, SBL_LOG_ERROR, SBL_LOG_ITEM_TOO_LARGE, "the program \"%s\" reads %d textures; there are %d "
             "texture units (GL 3.3 promises 16, of which sbl.h uses %d)", name, textures, gl->units, SBL__GUARD_UNITS);
    return SBL_ERROR_UNSUPPORTED;
}

static sbl_result sbl__program_make(const sbl__device *d, sbl__program *program) {
    static const char *const names[SBL__FEATURES] = {
        "TEXTURED", "WIDE", "VIEWS", "INSPECT", "WRITE_DEPTH", "COMPUTE", "BOUNCED", "MIXED", "CUTOUTS",
        "GUIDED", "LIGHTMAP", "DIRECTIONAL", "DISPLAY"
    };
    const sbl__recipe *recipe = program->recipe;
    char prelude[SBL__PRELUDE_MOST];
    size_t length = 0;
    sbl_result result;
    int i;
    for (i = 0; i < SBL__FEATURES; i++)
        if (program->features >> i & 1) length = sbl__write(prelude, length, "#define SBL_%s\n", names[i]);
    length = sbl__write(prelude, length, "#define SBL_WORKGROUP %d\n", d->workgroup);
    length = sbl__write_constants(prelude, length);
    for (i = 0; sbl__glsl_tables[i]; i++) length = sbl__write(prelude, length, "%s", sbl__glsl_tables[i]);
    for (i = 0; i < SBL__SHADERS_MOST && recipe->records[i]; i++)
        length = sbl__write_record(prelude, length, recipe->records[i]);
    result = sbl__program_link(d, program, prelude);
    if (result == SBL_SUCCESS) result = sbl__program_check_textures(d, program->id, recipe->name);
    if (result == SBL_SUCCESS) result = sbl__gl_check(&d->gl);
    if (result != SBL_SUCCESS && program->id) d->gl.DeleteProgram(program->id);
    return result;
}

/* Returns a recipe's program for the given features and the device's, without features that the recipe does not list.
   Returns NULL if the program has not been compiled. */
static const sbl__program *sbl__program_find(const sbl__device *d, const sbl__recipe *recipe, unsigned features) {
    int i;
    features = (features | d->features) & recipe->features;
    for (i = 0; i < d->compiled.count; i++)
        if (d->programs[i].recipe == recipe && d->programs[i].features == features) return &d->programs[i];
    return NULL;
}

/* Compiles a recipe's program with these features if it has not been compiled. */
static sbl_result sbl__program_need(sbl__device *d, const sbl__recipe *recipe, unsigned features) {
    const char *doing = d->gl.doing;
    const double start = sbl__now();
    sbl__program *program = &d->programs[d->compiled.count];
    sbl_result result;
    if (sbl__program_find(d, recipe, features)) return SBL_SUCCESS;
    if (d->compiled.count == SBL__PROGRAMS_MOST) return SBL_ERROR_UNSUPPORTED;
    program->recipe = recipe;
    program->features = (features | d->features) & recipe->features;
    d->gl.doing = "making shader programs";
    result = sbl__program_make(d, program);
    d->gl.doing = doing;
    if (result != SBL_SUCCESS) return result;
    d->compiled.count++;
    d->compiled.compile_seconds += sbl__now() - start;
    return SBL_SUCCESS;
}

/* Makes a recipe's program the current program; compiles it if needed. */
static sbl_result sbl__use(sbl__device *d, const sbl__recipe *recipe, unsigned features) {
    const sbl_result result = sbl__program_need(d, recipe, features);
    if (result != SBL_SUCCESS) return result;
    d->program = sbl__program_find(d, recipe, features)->id;
    d->unit = 0;
    d->gl.UseProgram(d->program);
    return SBL_SUCCESS;
}

/* >>device: uniforms and textures of the program in use. Names that the program does not have are ignored. */

static int sbl__place(const sbl__device *d, const char *name) { return d->gl.GetUniformLocation(d->program, name); }

static void sbl__set_int(const sbl__device *d, const char *name, int x) { d->gl.Uniform1i(sbl__place(d, name), x); }

static void sbl__set_ints(const sbl__device *d, const char *name, int x, int y) {
    d->gl.Uniform2i(sbl__place(d, name), x, y);
}

static void sbl__set_float(const sbl__device *d, const char *name, float x) { d->gl.Uniform1f(sbl__place(d, name), x); }

static void sbl__set_vec2(const sbl__device *d, const char *name, float x, float y) {
    d->gl.Uniform2f(sbl__place(d, name), x, y);
}

static void sbl__set_vec3(const sbl__device *d, const char *name, const float v[3]) {
    d->gl.Uniform3f(sbl__place(d, name), v[0], v[1], v[2]);
}

static void sbl__set_vec4(const sbl__device *d, const char *name, const float v[4]) {
    d->gl.Uniform4f(sbl__place(d, name), v[0], v[1], v[2], v[3]);
}

static void sbl__bind_to(sbl__device *d, const char *name, unsigned target, unsigned texture) {
    const int place = sbl__place(d, name);
    if (place < 0) return;
    d->gl.ActiveTexture(SBL__GL_TEXTURE0 + (unsigned)d->unit);
    d->gl.BindTexture(target, texture);
    d->gl.Uniform1i(place, d->unit++);
}

static void sbl__bind(sbl__device *d, const char *name, const sbl__texture *t) {
    sbl__bind_to(d, name, SBL__GL_TEXTURE_2D, t->id);
}

static void sbl__bind_table(sbl__device *d, const char *name, const sbl__table *t) {
    sbl__bind_to(d, name, t->texels.width ? SBL__GL_TEXTURE_2D : SBL__GL_TEXTURE_BUFFER, t->texels.id);
}

/* >>device: passes and draws */

enum { SBL__PASS_DEPTH = 1, SBL__PASS_CLIP = 2 };  /* enables the depth test; enables four clip distances */

/* Begins a pass: the following draws go to the target. viewport and scissor: x, y, width, height; NULL: the whole
   target. flags: SBL__PASS_... */
static void sbl__pass(const sbl__device *d, const sbl__target *t, const int *viewport, const int *scissor, int flags) {
    const sbl__gl *gl = &d->gl;
    unsigned i;
    gl->BindFramebuffer(SBL__GL_DRAW_FRAMEBUFFER, t->id);
    if (viewport) gl->Viewport(viewport[0], viewport[1], viewport[2], viewport[3]);
    else gl->Viewport(0, 0, t->width, t->height);
    if (scissor) gl->Scissor(scissor[0], scissor[1], scissor[2], scissor[3]);
    (scissor ? gl->Enable : gl->Disable)(SBL__GL_SCISSOR_TEST);
    (flags & SBL__PASS_DEPTH ? gl->Enable : gl->Disable)(SBL__GL_DEPTH_TEST);
    for (i = 0; i < 4; i++) (flags & SBL__PASS_CLIP ? gl->Enable : gl->Disable)(SBL__GL_CLIP_DISTANCE0 + i);
}

/* Begins a pass over rows of a target. */
static void sbl__pass_rows(const sbl__device *d, const sbl__target *t, int row, int rows) {
    const int area[4] = { 0, row, t->width, rows };
    sbl__pass(d, t, area, NULL, 0);
}

/* Clears colour attachment 0 and the depth buffer of a pass, inside the scissor. color: NULL if the attachment
   holds integers, which become 0 */
static void sbl__clear(const sbl__device *d, const float *color) {
    static const unsigned zero[4] = { 0, 0, 0, 0 };
    static const float farthest = 0;
    if (color) d->gl.ClearBufferfv(SBL__GL_COLOR, 0, color);
    else d->gl.ClearBufferuiv(SBL__GL_COLOR, 0, zero);
    d->gl.ClearBufferfv(SBL__GL_DEPTH, 0, &farthest);
}

/* Draws instances of the triangles first .. first + count - 1 of a vertex array with indices. */
static void sbl__draw_mesh(const sbl__device *d, unsigned array, int first, int count, int instances) {
    d->gl.BindVertexArray(array);
    d->gl.DrawElementsInstanced(SBL__GL_TRIANGLES, 3 * count, SBL__GL_UNSIGNED_INT,
                                (const void *)(12 * (uintptr_t)first), instances);
}

/* Draws `count` triangles without vertex attributes; gl_VertexID begins at 3 * first. */
static void sbl__draw_triangles(const sbl__device *d, int first, int count) {
    d->gl.BindVertexArray(d->empty_array);
    d->gl.DrawArraysInstanced(SBL__GL_TRIANGLES, 3 * first, 3 * count, 1);
}

/* Draws a triangle that covers the viewport, for fullscreen_vertex.glsl. */
static void sbl__draw_screen(const sbl__device *d) { sbl__draw_triangles(d, 0, 1); }

/* Draws instances of a rectangle as a strip of two triangles: gl_VertexID is 0 to 3. */
static void sbl__draw_rectangles(const sbl__device *d, unsigned array, int instances) {
    d->gl.BindVertexArray(array);
    d->gl.DrawArraysInstanced(SBL__GL_TRIANGLE_STRIP, 0, 4, instances);
}

/* Runs the program in use (see carrier.glsl): a compute shader with `count` invocations or, without SBL__COMPUTE, a
   fragment shader over `rows` rows of the target. Both write the same numbers. The choice depends on the driver, not on
   measured times, so that pictures do not depend on timings; on llvmpipe, compute is not slower. */
static void sbl__invoke(const sbl__device *d, const sbl__target *t, int row, int rows, int count) {
    const sbl__gl *gl = &d->gl;
    int i;
    if (d->features & SBL__COMPUTE) {
        for (i = 0; i < t->count; i++)
            gl->BindImageTexture((unsigned)i, t->textures[i], 0, 0, 0, SBL__GL_WRITE_ONLY, SBL__GL_RGBA32F);
        /* Waits for earlier work that uses the images. The parentheses avoid the macro MemoryBarrier of windows.h. */
        (gl->MemoryBarrier)(SBL__GL_SHADER_IMAGE_ACCESS_BARRIER);
        gl->DispatchCompute((unsigned)((count + d->workgroup - 1) / d->workgroup), 1, 1);
        (gl->MemoryBarrier)(SBL__GL_TEXTURE_FETCH_BARRIER | SBL__GL_FRAMEBUFFER_BARRIER);
    } else {
        sbl__pass_rows(d, t, row, rows);
        sbl__draw_screen(d);
    }
}

/* Rounds a number of items to the nearest multiple of a lot, at least one lot. invocations: per item */
static double sbl__whole_lots(const sbl__device *d, double items, int invocations) {
    const double lot = SBL__MAX(d->lot / invocations, 1);
    return SBL__MAX(floor(items / lot + 0.5), 1.0) * lot;
}

/* An attribute of a vertex array, and its place in a buffer. */
typedef struct sbl__input {
    int location, components;
    unsigned type;
    int integer;    /* 1: the shader's input is an integer; 0: it is a float, to which integers are normalised */
    int instances;  /* 1: the input changes with each instance; 0: with each vertex */
    size_t stride, offset;
} sbl__input;

static sbl_result sbl__array_make(const sbl__device *d, unsigned *array, const sbl__buffer *indices) {
    if (!sbl__name_make(d, d->gl.GenVertexArrays, array)) return SBL_ERROR_GL;
    d->gl.BindVertexArray(*array);
    d->gl.BindBuffer(SBL__GL_ELEMENT_ARRAY_BUFFER, indices->id);
    d->gl.BindVertexArray(0);
    return sbl__gl_check(&d->gl);
}

static void sbl__array_inputs(const sbl__device *d, unsigned array, const sbl__buffer *b, const sbl__input *inputs,
                              int count) {
    const sbl__gl *gl = &d->gl;
    int i;
    gl->BindVertexArray(array);
    gl->BindBuffer(SBL__GL_ARRAY_BUFFER, b->id);
    for (i = 0; i < count; i++) {
        const sbl__input *a = &inputs[i];
        const void *offset = (const void *)(uintptr_t)a->offset;
        if (a->integer) gl->VertexAttribIPointer((unsigned)a->location, a->components, a->type, (int)a->stride, offset);
        else gl->VertexAttribPointer((unsigned)a->location, a->components, a->type, a->type != SBL__GL_FLOAT,
                                     (int)a->stride, offset);
        gl->EnableVertexAttribArray((unsigned)a->location);
        gl->VertexAttribDivisor((unsigned)a->location, (unsigned)a->instances);
    }
    gl->BindVertexArray(0);
}

static void sbl__array_delete(const sbl__device *d, unsigned *array) {
    if (*array) d->gl.DeleteVertexArrays(1, array);
    *array = 0;
}

/* >>device: buffers and textures of the host */

/* Returns the size of a buffer in bytes, or -1 if there is no such buffer. */
static int64_t sbl__host_buffer_bytes(const sbl__device *d, unsigned name) {
    int64_t size = 0;
    if (!d->gl.IsBuffer(name)) return -1;
    d->gl.BindBuffer(SBL__GL_COPY_READ_BUFFER, name);
    d->gl.GetBufferParameteri64v(SBL__GL_COPY_READ_BUFFER, SBL__GL_BUFFER_SIZE, &size);
    return size;
}

static sbl_result sbl__host_buffer_read(const sbl__device *d, unsigned name, size_t offset, size_t bytes, void *out) {
    d->gl.BindBuffer(SBL__GL_COPY_READ_BUFFER, name);
    d->gl.GetBufferSubData(SBL__GL_COPY_READ_BUFFER, (ptrdiff_t)offset, (ptrdiff_t)bytes, out);
    return sbl__gl_check(&d->gl);
}

static int sbl__host_texture_exists(const sbl__device *d, unsigned name) { return d->gl.IsTexture(name) != 0; }

/* Gets the width and height of level 0 of a texture. Returns an error if it is not a GL_TEXTURE_2D. */
static sbl_result sbl__host_texture_size(const sbl__device *d, unsigned name, int size[2]) {
    const sbl__gl *gl = &d->gl;
    gl->ActiveTexture(SBL__GL_TEXTURE0);
    gl->BindTexture(SBL__GL_TEXTURE_2D, name);
    gl->GetTexLevelParameteriv(SBL__GL_TEXTURE_2D, 0, SBL__GL_TEXTURE_WIDTH, &size[0]);
    gl->GetTexLevelParameteriv(SBL__GL_TEXTURE_2D, 0, SBL__GL_TEXTURE_HEIGHT, &size[1]);
    return sbl__gl_check(gl);
}

/* >>glsl fullscreen_vertex: shaders_embedded/fullscreen_vertex.glsl, copied by scripts/embed_shaders */
static const char *const sbl__glsl_fullscreen_vertex[] = {
"// One triangle that covers the viewport; drawn with three vertices and no buffers.\n",
"void main() { gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0, 1); }\n",
0 };
/* <<glsl */

/* >>glsl copy: shaders_embedded/copy.glsl, copied by scripts/embed_shaders */
static const char *const sbl__glsl_copy[] = {
"// Copies a texture of the host. texelFetch applies the texture's sRGB decoding and swizzle.\n",
"uniform sampler2D source;\n",
"layout(location = 0) out vec4 out_color;\n",
"\n",
"void main() { out_color = texelFetch(source, ivec2(gl_FragCoord.xy), 0); }\n",
0 };
/* <<glsl */

static const sbl__recipe sbl__recipe_copy = {
    "copy", { sbl__glsl_fullscreen_vertex }, { sbl__glsl_copy }, { NULL }, 0
};

/* Reads level 0 of a texture as texelFetch returns it (see copy.glsl): 4 floats per texel. */
static sbl_result sbl__host_texture_read(sbl__device *d, unsigned name, const int size[2], float *out) {
    const sbl__gl *gl = &d->gl;
    sbl__texture texture = { 0, 0, 0, 0, 0 };
    sbl__target target = { 0, 0, 0, 0, { 0 }, { 0 } };
    unsigned sampler = 0;
    sbl_result result = sbl__texture_make(d, &texture, size[0], size[1], SBL__GL_RGBA32F);
    if (result == SBL_SUCCESS) result = sbl__target_make(d, &target, &texture, 1, NULL);
    if (result == SBL_SUCCESS) result = sbl__use(d, &sbl__recipe_copy, 0);
    if (result == SBL_SUCCESS && !sbl__name_make(d, gl->GenSamplers, &sampler)) result = SBL_ERROR_GL;
    if (result == SBL_SUCCESS) {
        sbl__bind_to(d, "source", SBL__GL_TEXTURE_2D, name);
        /* This sampler needs no mip maps. With GL's default filter, a texture without them is incomplete. */
        gl->SamplerParameteri(sampler, SBL__GL_TEXTURE_MIN_FILTER, SBL__GL_NEAREST);
        gl->SamplerParameteri(sampler, SBL__GL_TEXTURE_MAG_FILTER, SBL__GL_NEAREST);
        gl->BindSampler(0, sampler);
        sbl__pass(d, &target, NULL, NULL, 0);
        sbl__draw_screen(d);
        result = sbl__target_read(d, &target, 0, 0, size[1], out);
        gl->BindSampler(0, 0);
        gl->DeleteSamplers(1, &sampler);
    }
    sbl__target_delete(d, &target);
    sbl__texture_delete(d, &texture);
    return result;
}

/* Lets the host draw a view into its viewport in a target, then restores the state that passes rely on. Computes
   world_to_clip and write_depth; the caller sets the other fields. */
static void sbl__host_draw(const sbl__device *d, const sbl__target *t, sbl_draw_function draw, sbl_draw_view *view,
                           void *user) {
    sbl__multiply(view->world_to_clip, view->view_to_clip, view->world_to_view);
    view->write_depth = (d->features & SBL__WRITE_DEPTH) != 0;
    sbl__pass(d, t, view->viewport, view->viewport, SBL__PASS_DEPTH);
    draw(view, user);
    sbl__guard_force(&d->gl);
}

/* >>device: time. Work is done in pieces. Loops on the CPU read the clock in every 64th turn. The size of a piece on
   the GPU is computed from the time that earlier pieces of its kind took. Neither may change a result. */

/* The time that a call of sbl_step may take. */
typedef struct sbl__slice {
    double end;      /* end of the slice, on the clock of sbl__now */
    double longest;  /* longest allowed time of a submission, seconds */
    int turns;       /* turns of loops on the CPU since the clock was last read */
} sbl__slice;

/* Begins a slice. seconds: its length; 0 or less: unlimited */
static sbl__slice sbl__slice_of(const sbl_context_desc *desc, double seconds) {
    const sbl__slice slice = { seconds > 0 ? sbl__now() + seconds : DBL_MAX, desc->longest_submission, 0 };
    return slice;
}

/* Returns 1 if the slice is over. Loops on the CPU call this in each turn; every 64th call reads the clock. */
static int sbl__late(sbl__slice *s) {
    if (++s->turns < 64) return 0;
    s->turns = 0;
    return sbl__now() >= s->end;
}

/* The pace of one kind of GPU work. cost: estimated seconds per unit of work, 0 before the first measurement. start:
   when the current submission began */
typedef struct sbl__pace { double cost, start; } sbl__pace;

/* A submission is planned to take PACE_MARGIN times the rest of the slice, which may be overrun occasionally, but at
   most PACE_CAUTION times the longest allowed submission, which must not be exceeded, and at least PACE_LEAST seconds,
   because waiting for shorter submissions wastes too much time. If a measured cost is lower than the estimate, the
   estimate falls by PACE_FALL of the difference, or by PACE_FAR_FALL of it if the measured cost is less than PACE_FAR
   times the estimate, for example because the driver compiled a shader during an earlier submission. */
#define SBL__PACE_MARGIN 0.9
#define SBL__PACE_CAUTION 0.5
#define SBL__PACE_LEAST 0.001
#define SBL__PACE_FALL 0.1
#define SBL__PACE_FAR 0.25
#define SBL__PACE_FAR_FALL 0.5

/* Starts the clock for a submission and returns how many units of work it should have. first: number of units while
   the cost is unknown. least: smallest number to return */
static double sbl__pace_begin(sbl__pace *p, const sbl__slice *s, double first, double least) {
    double seconds;
    p->start = sbl__now();
    seconds = SBL__MIN(s->longest * SBL__PACE_CAUTION, (s->end - p->start) * SBL__PACE_MARGIN);
    seconds = SBL__MAX(seconds, SBL__PACE_LEAST);
    return SBL__MAX(p->cost > 0 ? seconds / p->cost : first, least);
}

#define SBL__PACE_PIXELS 16384  /* pixels of the first submission of a pass, while its cost is unknown */

/* Calls sbl__pace_begin for a pass over a target, in pixels. Returns the number of rows to draw, from `row` on. */
static int sbl__pace_rows(sbl__pace *p, const sbl__slice *s, const sbl__target *t, int row) {
    const double rows = sbl__pace_begin(p, s, SBL__PACE_PIXELS, t->width) / t->width;
    return rows < t->height - row ? (int)rows : t->height - row;
}

/* Ends a submission without waiting for it. */
static void sbl__submit(const sbl__device *d) { d->gl.Flush(); }

/* Waits until the GPU has finished a submission of `units` units of work, and updates the cost. The cost rises at once
   and falls slowly, because work that was cheap a few times can be expensive again. Returns GL errors. */
static sbl_result sbl__pace_end(const sbl__device *d, sbl__pace *p, double units) {
    double cost, fall;
    d->gl.Finish();
    cost = SBL__MAX(sbl__now() - p->start, 1e-6) / units;
    fall = cost < SBL__PACE_FAR * p->cost ? SBL__PACE_FAR_FALL : SBL__PACE_FALL;
    p->cost = p->cost > cost ? p->cost + fall * (cost - p->cost) : cost;
    return sbl__gl_check(&d->gl);
}

/* >>device: stages. Long work is a list of stages, each done in pieces that fit into a slice. A table has a row for
   each stage, in their order; the number of rows stands for work that is done. A room that must know whether its work
   has begun leaves row 0 empty. A stage is a function that does one piece at a time, or a loop over many small things;
   a loop may have a `piece` too, which runs whenever the loop starts or continues. To add a stage, add a row and, if
   other stages refer to it, its name in the room's enum. */
typedef struct sbl__stage_row {
    sbl_result (*piece)(void *work, sbl__slice *slice);  /* does one piece; SBL_UNFINISHED: pieces remain */
    int (*next)(void *work);                             /* returns the next stage; NULL: the next row follows */
    sbl_result (*turn)(void *work, int at);              /* does turn `at` of a loop; NULL: the stage is not a loop */
    int (*count)(void *work);                            /* returns how often `turn` is to be called in all; asked
                                                            again before each call */
} sbl__stage_row;

/* The progress of staged work. */
typedef struct sbl__stages {
    int stage;  /* current stage: index of its row in the table of stages */
    int at;     /* next turn of a loop, or a counter that a piece may use as it likes; 0 when the stage begins */
} sbl__stages;

/* Does one piece of the current stage, or as many turns of its loop as there is time for. Returns SBL_UNFINISHED until
   the last stage is done, then SBL_SUCCESS. */
static sbl_result sbl__stages_step(sbl__stages *s, const sbl__stage_row *table, int row_count, void *work,
                                   sbl__slice *slice) {
    if (s->stage < row_count) {
        const sbl__stage_row *row = &table[s->stage];
        sbl_result result = row->piece ? row->piece(work, slice) : SBL_SUCCESS;
        for (; row->turn && s->at < row->count(work) && result == SBL_SUCCESS; s->at++) {
            if (sbl__late(slice)) return SBL_UNFINISHED;
            result = row->turn(work, s->at);
        }
        if (result != SBL_SUCCESS) return result;
        s->stage = row->next ? row->next(work) : s->stage + 1;
        s->at = 0;
    }
    return s->stage < row_count ? SBL_UNFINISHED : SBL_SUCCESS;
}

/* Repeats sbl__stages_step while it completes stages, for work with many short stages. */
static sbl_result sbl__stages_run(sbl__stages *s, const sbl__stage_row *table, int row_count, void *work,
                                  sbl__slice *slice) {
    sbl_result result;
    int stage;
    do {
        stage = s->stage;
        result = sbl__stages_step(s, table, row_count, work, slice);
    } while (result == SBL_UNFINISHED && s->stage != stage);
    return result;
}

/* >>device: creation and deletion */

/* Loads GL and makes the vertex array that all passes share. Changes no state of the host. */
static sbl_result sbl__device_make(sbl__device *d, const sbl_context_desc *desc) {
    static const char *const cpu_renderers[] = { "llvmpipe", "softpipe", "SwiftShader" };
    const sbl_result result = sbl__gl_load(&d->gl, desc);
    int i, on_cpu = 0;
    if (result != SBL_SUCCESS) return result;
    if (!(d->gl.capabilities.used & SBL_CAPABILITY_CLIP_CONTROL)) d->features |= SBL__WRITE_DEPTH;
    if (d->gl.capabilities.used & SBL_CAPABILITY_COMPUTE) d->features |= SBL__COMPUTE;
    /* A renderer on the CPU runs each workgroup in one thread, so small workgroups leave fewer threads idle at the end
       of a submission: on llvmpipe, work in slices of 5 ms is 10 to 15 % faster with 8 (the width of its vectors) than
       with 64. A lot of two workgroups keeps the pace from settling on submissions that use one thread: with expensive
       looks (staircase2, high), work in slices takes 9 % longer than work in one call, instead of 75 %. A GPU needs at
       least a wavefront, which is at most 64 wide, and several on each core; this was not measured. */
    for (i = 0; i < SBL__COUNT(cpu_renderers); i++)
        on_cpu |= strstr(d->gl.capabilities.renderer, cpu_renderers[i]) != NULL;
    d->workgroup = on_cpu ? 8 : 64;
    d->lot = on_cpu ? 16 : 1024;
    return sbl__name_make(d, d->gl.GenVertexArrays, &d->empty_array) ? sbl__gl_check(&d->gl) : SBL_ERROR_GL;
}

/* Returns 1 if the GL functions are loaded, so that GL objects can exist. */
static int sbl__device_is_made(const sbl__device *d) { return d->gl.GetError && d->gl.capabilities.gl_major; }

static void sbl__device_free(sbl__device *d) {
    int i;
    for (i = 0; i < d->compiled.count; i++) d->gl.DeleteProgram(d->programs[i].id);
    sbl__array_delete(d, &d->empty_array);
}

/* ======================================================================================================== >>check
   Validates descriptors field by field, before anything changes. Every mistake is logged with the place, name and value
   of the field and with what it must be. */

typedef struct sbl__check {
    const sbl__base *base;
    const sbl__device *device;  /* looks up the GL objects that a descriptor names; NULL if it can name none */
    sbl_log_item item;          /* log item of the mistakes */
    char where[32];             /* start of messages: the descriptor, the function, or an object such as "mesh 3" */
    int mistakes;               /* number of mistakes found so far */
} sbl__check;

static void sbl__mistake(sbl__check *check, const char *format, ...) {
    char text[512];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    check->mistakes++;
    sbl__log(check->base, SBL_LOG_ERROR, check->item, "%s: %s", check->where, text);
}

/* Makes an object such as mesh 3 the place of the mistakes that follow. */
static void sbl__check_object(sbl__check *check, sbl_log_item item, const char *kind, int number) {
    check->item = item;
    snprintf(check->where, sizeof check->where, "%s %d", kind, number);
}

static sbl_result sbl__check_end(const sbl__check *check) {
    return check->mistakes ? SBL_ERROR_INVALID_ARGUMENT : SBL_SUCCESS;
}

/* Returns 1 if both canaries are 0. Otherwise reports that the host has not zeroed the struct, and returns 0. */
static int sbl__check_canaries(sbl__check *check, uint32_t start, uint32_t end) {
    if (start == 0 && end == 0) return 1;
    sbl__mistake(check, "start_canary is 0x%x, end_canary 0x%x; zero the whole struct before use", start, end);
    return 0;
}

static const float sbl__any_range[2] = { -FLT_MAX, FLT_MAX }, sbl__not_negative_range[2] = { 0, FLT_MAX };
static const float sbl__unit_range[2] = { 0, 1 };

/* Checks that numbers are finite and in range[0] .. range[1]. name: field in messages */
static void sbl__check_range(sbl__check *check, const char *name, const float *v, int count, const float range[2]) {
    int k;
    for (k = 0; k < count; k++) {
        char index[16] = "", limits[64] = "finite";
        if (sbl__between(&v[k], range[0], range[1])) continue;
        if (count > 1) snprintf(index, sizeof index, "[%d]", k);
        if (range[1] < FLT_MAX) snprintf(limits, sizeof limits, "%g to %g", (double)range[0], (double)range[1]);
        else if (range[0] >= 0) snprintf(limits, sizeof limits, "finite and not negative");
        sbl__mistake(check, "%s%s is %g; it must be %s", name, index, (double)v[k], limits);
    }
}

static void sbl__check_finite(sbl__check *check, const char *name, const float *v, int count) {
    sbl__check_range(check, name, v, count, sbl__any_range);
}

/* Checks that a count is not negative and, if it is above 0, that its array is not NULL. name: field of the count */
static void sbl__check_array(sbl__check *check, const char *name, int count, const void *array) {
    if (count < 0 || (count > 0 && !array))
        sbl__mistake(check, "%s is %d and its array is %s; a count must not be negative, and a count above 0 needs an "
                     "array", name, count, array ? "given" : "NULL");
}

/* Returns 1 if low <= x <= high. Otherwise reports a mistake and returns 0. */
static int sbl__check_int(sbl__check *check, const char *name, int x, int low, int high) {
    if (x >= low && x <= high) return 1;
    sbl__mistake(check, "%s is %d; it must be %d to %d", name, x, low, high);
    return 0;
}

/* >>check: meshes */

/* For each sbl_type: size of a component in bytes, and the factor from stored to real values */
static const struct { int bytes; double scale; } sbl__types[SBL_TYPE_COUNT] = {
    { 4, 1 }, { 2, 1 }, { 1, 1 / 255.0 }, { 2, 1 / 65535.0 }, { 1, 1 / 127.0 }, { 2, 1 / 32767.0 },
    { 1, 1 }, { 2, 1 }, { 4, 1 }
};

static int sbl__stream_present(const sbl_stream *s) { return s->data != NULL || s->gl_buffer != 0; }

/* A stream of a mesh and its layout. Elements of one component are indices; all others are read as floats. */
typedef struct sbl__stream_use {
    const char *name;          /* field of sbl_mesh, for messages */
    const sbl_stream *stream;
    int components;            /* number of components of an element */
    int count;                 /* number of elements */
} sbl__stream_use;

enum {
    SBL__POSITIONS, SBL__NORMALS, SBL__TEXCOORDS, SBL__COLORS, SBL__LIGHTMAP_TEXCOORDS, SBL__INDICES, SBL__STREAMS
};

static size_t sbl__stream_element(const sbl__stream_use *use) {
    return (size_t)sbl__types[use->stream->type].bytes * (size_t)use->components;
}

static size_t sbl__stream_stride(const sbl__stream_use *use) {
    return use->stream->stride ? use->stream->stride : sbl__stream_element(use);
}

/* Describes the streams of a mesh. out: indexed by SBL__POSITIONS to SBL__INDICES */
static void sbl__mesh_streams(const sbl_mesh *m, sbl__stream_use out[SBL__STREAMS]) {
    const sbl__stream_use streams[SBL__STREAMS] = {
        { "positions", &m->positions, 3, m->vertex_count }, { "normals", &m->normals, 3, m->vertex_count },
        { "texcoords", &m->texcoords, 2, m->vertex_count }, { "colors", &m->colors, 4, m->vertex_count },
        { "lightmap_texcoords", &m->lightmap_texcoords, 2, m->vertex_count },
        { "indices", &m->indices, 1, m->index_count }
    };
    memcpy(out, streams, sizeof streams);
}

/* Checks that a stream's type fits, that its elements do not overlap, and that they lie inside the address space and
   inside the stream's GL buffer, if it has one. Does not read the elements. */
static void sbl__check_stream(sbl__check *check, const sbl__stream_use *use) {
    const sbl_stream *s = use->stream;
    const int type = (int)s->type, is_index = use->components == 1;
    size_t element, stride;
    double size, needed;
    if (!sbl__stream_present(s)) return;
    if (s->data && s->gl_buffer)
        sbl__mistake(check, "%s.data and %s.gl_buffer (%u) are both set; give one", use->name, use->name, s->gl_buffer);
    if (type < 0 || type >= SBL_TYPE_COUNT || (type >= (int)SBL_UINT8) != is_index) {
        sbl__mistake(check, "%s.type is %d; %s", use->name, type, is_index ?
                     "it must be SBL_UINT8, SBL_UINT16 or SBL_UINT32" : "it must be a float or normalised type");
        return;
    }
    if (s->type == SBL_UINT8_NORM && use->components == 3)
        sbl__mistake(check, "%s.type is %d, SBL_UINT8_NORM; only colours and texture coordinates may have it",
                     use->name, type);
    element = sbl__stream_element(use);
    stride = sbl__stream_stride(use);
    if (stride < element)
        sbl__mistake(check, "%s.stride is %.0f; it must be at least the %.0f bytes of an element", use->name,
                     (double)stride, (double)element);
    if (stride < element || use->count <= 0) return;
    if ((size_t)use->count - 1 > (SIZE_MAX / 2 - element) / stride || s->offset > SIZE_MAX / 2) {
        sbl__mistake(check, "%s.offset is %.0f and its stride %.0f; %d elements exceed the address space", use->name,
                     (double)s->offset, (double)stride, use->count);
        return;
    }
    if (!s->gl_buffer) return;
    size = SBL__MAX(0.0, (double)sbl__host_buffer_bytes(check->device, s->gl_buffer));
    needed = (double)stride * (use->count - 1) + (double)element;
    if (size < (double)s->offset + needed)
        sbl__mistake(check, "%s.gl_buffer %u holds %.0f bytes; its %d elements from offset %.0f on need %.0f",
                     use->name, s->gl_buffer, size, use->count, (double)s->offset, needed);
}

static void sbl__check_transform(sbl__check *check, const float m[16]) {
    if (!sbl__all_finite(m, 16)) sbl__check_finite(check, "transform", m, 16);
    else if (!sbl__all_zero(m, 16) && sbl__affine_determinant(m) == 0)
        sbl__mistake(check, "transform is singular or not affine (its last row is %g %g %g %g, its determinant %g); it "
                     "must be invertible with last row 0 0 0 1", (double)m[3], (double)m[7], (double)m[11],
                     (double)m[15], sbl__affine_determinant(m));
}

static void sbl__check_mesh(sbl__check *check, const sbl_scene_desc *desc, int number) {
    const sbl_mesh *m = &desc->meshes[number];
    sbl__stream_use streams[SBL__STREAMS];
    const int indexed = sbl__stream_present(&m->indices);
    int i;
    sbl__check_object(check, SBL_LOG_ITEM_INVALID_MESH, "mesh", number);
    if (!sbl__check_int(check, "vertex_count", m->vertex_count, 0, INT_MAX)) return;
    if (m->vertex_count > 0 && !sbl__stream_present(&m->positions))
        sbl__mistake(check, "positions are missing (data and gl_buffer are both 0) for vertex_count %d",
                     m->vertex_count);
    sbl__mesh_streams(m, streams);
    for (i = 0; i < SBL__INDICES; i++) sbl__check_stream(check, &streams[i]);
    if (indexed && (m->index_count < 0 || m->index_count % 3 != 0))
        sbl__mistake(check, "index_count is %d; it must be a multiple of 3", m->index_count);
    else if (indexed) sbl__check_stream(check, &streams[SBL__INDICES]);
    else if (m->vertex_count % 3 != 0)
        sbl__mistake(check, "vertex_count is %d; without indices it must be a multiple of 3", m->vertex_count);
    sbl__check_transform(check, m->transform);
    if (m->material < 0 || m->material >= desc->material_count)
        sbl__mistake(check, "material is %d; it must be 0 or more, and less than material_count (%d)", m->material,
                     desc->material_count);
}

/* >>check: materials and textures */

static void sbl__check_material(sbl__check *check, const sbl_scene_desc *desc, int number) {
    const sbl_material *m = &desc->materials[number];
    sbl__check_object(check, SBL_LOG_ITEM_INVALID_MATERIAL, "material", number);
    sbl__check_range(check, "albedo", m->albedo, 3, sbl__unit_range);
    sbl__check_range(check, "emission", m->emission, 3, sbl__not_negative_range);
    sbl__check_int(check, "albedo_texture (0: none)", m->albedo_texture, 0, desc->texture_count);
    sbl__check_int(check, "emission_texture (0: none)", m->emission_texture, 0, desc->texture_count);
    sbl__check_range(check, "alpha_cutoff", &m->alpha_cutoff, 1, sbl__unit_range);
    if (m->flags & ~(uint32_t)SBL_MATERIAL_FLAGS_ALL)
        sbl__mistake(check, "flags is 0x%x; only the bits 0x%x exist", m->flags, (unsigned)SBL_MATERIAL_FLAGS_ALL);
}

static int sbl__texture_channels(const sbl_texture *t) { return t->channels ? t->channels : 4; }

/* Returns the size of a pixel in client memory, in bytes. */
static size_t sbl__texture_pixel_bytes(const sbl_texture *t) {
    return (size_t)sbl__texture_channels(t) * (t->format == SBL_PIXELS_FLOAT ? 4u : 1u);
}

static size_t sbl__texture_stride(const sbl_texture *t, int width) {
    return t->stride ? t->stride : (size_t)width * sbl__texture_pixel_bytes(t);
}

/* Checks the channels, size and stride of pixels in client memory. prefix: "" or "picture.", precedes field names in
   messages. most: largest width and height */
static void sbl__check_pixels(sbl__check *check, const char *prefix, const sbl_texture *t, int most) {
    if (t->channels < 0 || t->channels > 4)
        sbl__mistake(check, "%schannels is %d; it must be 1 to 4, or 0 for 4", prefix, t->channels);
    else if (t->width < 1 || t->height < 1 || t->width > most || t->height > most)
        sbl__mistake(check, "%ssize is %d x %d; both must be 1 to %d", prefix, t->width, t->height, most);
    else if (t->stride && t->stride < (size_t)t->width * sbl__texture_pixel_bytes(t))
        sbl__mistake(check, "%sstride is %.0f; it must be at least the %.0f bytes of a row", prefix, (double)t->stride,
                     (double)t->width * (double)sbl__texture_pixel_bytes(t));
    else if (t->stride > SIZE_MAX / 4 / (size_t)t->height)
        sbl__mistake(check, "%sstride is %.0f; %d rows of it exceed the address space", prefix, (double)t->stride,
                     t->height);
}

#define SBL__TEXTURE_MOST 65536  /* largest width and height of a texture, in pixels */

static void sbl__check_texture(sbl__check *check, const sbl_scene_desc *desc, int index) {
    const sbl_texture *t = &desc->textures[index];
    sbl__check_object(check, SBL_LOG_ITEM_INVALID_TEXTURE, "texture", index + 1);  /* materials count from 1 */
    if (!sbl__check_int(check, "format", (int)t->format, 0, SBL_PIXEL_FORMAT_COUNT - 1)) return;
    sbl__check_int(check, "wrap", (int)t->wrap, 0, SBL_WRAP_COUNT - 1);
    if (t->pixels && t->gl_texture)
        sbl__mistake(check, "pixels and gl_texture (%u) are both set; give one", t->gl_texture);
    else if (!t->pixels && !t->gl_texture)
        sbl__mistake(check, "pixels and gl_texture are both 0; a texture needs pixels");
    else if (t->gl_texture) {
        if (!sbl__host_texture_exists(check->device, t->gl_texture))
            sbl__mistake(check, "gl_texture %u is not a texture of the current GL context", t->gl_texture);
        return;
    }
    sbl__check_pixels(check, "", t, SBL__TEXTURE_MOST);
}

/* >>check: lights and the environment */

/* Full angle of a spot light's cone in degrees; 0 in sbl_light means 90 */
#define SBL__CONE(light) ((light)->cone > 0.0f ? (light)->cone : 90.0f)

/* Largest width and height of the environment's picture, in texels; lamps store each texel coordinate in 15 bits */
#define SBL__SKY_MOST 16384

static void sbl__check_light(sbl__check *check, const sbl_light *l, int number) {
    static const float degrees[2] = { 0, 180 };
    const int distant = l->kind == SBL_LIGHT_DIRECTIONAL;
    sbl__check_object(check, SBL_LOG_ITEM_INVALID_LIGHT, "light", number);
    if (!sbl__check_int(check, "kind", (int)l->kind, 0, SBL_LIGHT_KIND_COUNT - 1)) return;
    sbl__check_range(check, "intensity", l->intensity, 3, sbl__not_negative_range);
    if (!distant) sbl__check_finite(check, "position", l->position, 3);
    if (l->kind != SBL_LIGHT_POINT) {
        sbl__check_finite(check, "direction", l->direction, 3);
        if (sbl__all_zero(l->direction, 3))
            sbl__mistake(check, "direction is 0 0 0; it must be the direction in which the light travels");
    }
    if (distant) sbl__check_range(check, "angle (in degrees)", &l->angle, 1, degrees);
    else sbl__check_range(check, "radius", &l->radius, 1, sbl__not_negative_range);
    if (l->kind != SBL_LIGHT_SPOT) return;
    sbl__check_range(check, "cone (in degrees)", &l->cone, 1, degrees);
    if (sbl__finite(&l->cone) && !sbl__between(&l->inner_cone, 0, SBL__CONE(l)))
        sbl__mistake(check, "inner_cone is %g; it must be 0 to the %g degrees of the cone", (double)l->inner_cone,
                     (double)SBL__CONE(l));
}

static void sbl__check_environment(sbl__check *check, const sbl_environment *e) {
    const sbl_texture *t = &e->picture;
    const int has_size = t->width || t->height;
    check->item = SBL_LOG_ITEM_INVALID_LIGHT;
    snprintf(check->where, sizeof check->where, "environment");
    if (t->gl_texture) sbl__mistake(check, "picture.gl_texture is %u; give pixels in client memory", t->gl_texture);
    if (t->pixels && e->radiance) sbl__mistake(check, "picture.pixels and radiance are both set; give one");
    if (!t->pixels && !e->radiance && has_size)
        sbl__mistake(check, "picture.pixels and radiance are both NULL, but the picture's size is %d x %d; give pixels "
                     "or a function", t->width, t->height);
    if (sbl__check_int(check, "picture.format", (int)t->format, 0, SBL_PIXEL_FORMAT_COUNT - 1) &&
        (t->pixels || has_size))
        sbl__check_pixels(check, "picture.", t, SBL__SKY_MOST);
    else sbl__check_int(check, "picture.channels", t->channels, 0, 4);
    sbl__check_finite(check, "scale", &e->scale, 1);
    sbl__check_finite(check, "rotation", &e->rotation, 1);
    sbl__check_finite(check, "up", e->up, 3);
}

/* >>check: whole descriptors */

static sbl_result sbl__check_scene(const sbl__device *d, const sbl_scene_desc *desc) {
    sbl__check check = { d->base, d, SBL_LOG_ITEM_INVALID_SCENE_DESC, "sbl_scene_desc", 0 };
    int i;
    if (!sbl__check_canaries(&check, desc->start_canary, desc->end_canary)) return sbl__check_end(&check);
    sbl__check_array(&check, "mesh_count", desc->mesh_count, desc->meshes);
    sbl__check_array(&check, "material_count", desc->material_count, desc->materials);
    sbl__check_array(&check, "texture_count", desc->texture_count, desc->textures);
    sbl__check_array(&check, "light_count", desc->light_count, desc->lights);
    sbl__check_range(&check, "sky", desc->sky, 3, sbl__not_negative_range);
    for (i = 0; desc->draw && i < 6; i++) {
        const float *low = &desc->draw_bounds[0][i % 3], *x = &desc->draw_bounds[i / 3][i % 3];
        if (!sbl__finite(x) || (sbl__finite(low) && *low > desc->draw_bounds[1][i % 3]))
            sbl__mistake(&check, "draw_bounds[%d][%d] is %g; bounds must be finite, lowest corner first", i / 3, i % 3,
                         (double)*x);
    }
    sbl__check_range(&check, "draw_max_radiance", &desc->draw_max_radiance, 1, sbl__not_negative_range);
    if (desc->max_bounce_cells) sbl__check_int(&check, "max_bounce_cells", desc->max_bounce_cells, 1024, 1048576);
    for (i = 0; desc->lights && i < desc->light_count; i++) sbl__check_light(&check, &desc->lights[i], i);
    sbl__check_environment(&check, &desc->environment);
    for (i = 0; desc->meshes && i < desc->mesh_count; i++) sbl__check_mesh(&check, desc, i);
    for (i = 0; desc->materials && i < desc->material_count; i++) sbl__check_material(&check, desc, i);
    for (i = 0; desc->textures && i < desc->texture_count; i++) sbl__check_texture(&check, desc, i);
    return sbl__check_end(&check);
}

SBL_API sbl_context_desc sbl_context_desc_defaults(const sbl_context_desc *desc) {
    sbl_context_desc d;
    memset(&d, 0, sizeof d);
    if (desc) d = *desc;
    if (!d.allocator.alloc && !d.allocator.free) {
        d.allocator.alloc = sbl__default_alloc;
        d.allocator.free = sbl__default_free;
    }
    if (!d.logger.log) d.logger.log = sbl__default_log;
    if (!d.sensor_texture_size) d.sensor_texture_size = 2048;
    if (sbl__zero(&d.longest_submission)) d.longest_submission = 0.1f;
    return d;
}

static sbl_result sbl__check_context(const sbl__base *base, const sbl_context_desc *d) {
    sbl__check check = { base, NULL, SBL_LOG_ITEM_INVALID_CONTEXT_DESC, "sbl_context_desc", 0 };
    if (!sbl__check_canaries(&check, d->start_canary, d->end_canary)) return sbl__check_end(&check);
    if (!d->allocator.alloc != !d->allocator.free)
        sbl__mistake(&check, "allocator.%s is NULL; give both functions or none",
                     d->allocator.alloc ? "free" : "alloc");
    if (d->disabled & ~(uint32_t)SBL_CAPABILITY_ALL)
        sbl__mistake(&check, "disabled is 0x%x; only the bits 0x%x exist", d->disabled, (unsigned)SBL_CAPABILITY_ALL);
    if (d->sensor_texture_size) sbl__check_int(&check, "sensor_texture_size", d->sensor_texture_size, 256, 16384);
    if (d->batch < 0) sbl__mistake(&check, "batch is %d; it cannot be negative", d->batch);
    sbl__check_range(&check, "longest_submission", &d->longest_submission, 1, sbl__not_negative_range);
    return sbl__check_end(&check);
}

/* ======================================================================================================== >>geometry
   Reads meshes from the host's streams, validates them, and converts them into four arrays, which are also on the GPU
   as tables:

       positions   per vertex: position in world space, number of its mesh's object
       attributes  per vertex: normal, texture coordinates, colour
       indices     per triangle: three vertex numbers; the triangles of mesh m begin at meshes[m].first_triangle
       objects     per mesh: its material                                                                           */

#define SBL__VERTEX(X) X(sbl__vertex, VEC3, position) X(sbl__vertex, UINT, object)
SBL__RECORD(sbl__vertex, SBL__VERTEX, "sbl_vertex", "sbl_positions", SBL__SCENE_TABLE("sbl_positions"), NULL)

/* color_rg and color_ba: two components of the colour, each 0 .. 65535; r and b are in the low 16 bits */
#define SBL__ATTRIBUTES(X) \
    X(sbl__attributes, VEC3, normal) X(sbl__attributes, FLOAT, u) \
    X(sbl__attributes, FLOAT, v) X(sbl__attributes, UINT, color_rg) X(sbl__attributes, UINT, color_ba) \
    X(sbl__attributes, UINT, unused)
SBL__RECORD(sbl__attributes, SBL__ATTRIBUTES, "sbl_attributes", "sbl_attributes", SBL__SCENE_TABLE("sbl_attributes"),
            NULL)

/* id: sbl_mesh.id or, if that is 0, the mesh's index + 1. albedo_texture, emission_texture: first row in the texel
   table, width, height, and SBL__TEXTURE flags; four zeroes if the object has no such texture */
#define SBL__OBJECT(X) \
    X(sbl__object, VEC3, albedo) X(sbl__object, FLOAT, alpha_cutoff) \
    X(sbl__object, VEC3, emission) X(sbl__object, UINT, flags) \
    X(sbl__object, UVEC4, albedo_texture) X(sbl__object, UVEC4, emission_texture) \
    X(sbl__object, UINT, id) X(sbl__object, UVEC3, unused)
SBL__RECORD(sbl__object, SBL__OBJECT, "sbl_object", "sbl_objects", SBL__SCENE_TABLE("sbl_objects"), NULL)

typedef struct sbl__mesh {
    int first_vertex, vertex_count, first_triangle, triangle_count;
    int material;
    int lightmapped;               /* 1 if the mesh has lightmap_texcoords */
    float transform[16];           /* object space to world space, column-major */
} sbl__mesh;

enum { SBL__POSITION_TABLE, SBL__ATTRIBUTE_TABLE, SBL__INDEX_TABLE, SBL__OBJECT_TABLE, SBL__GEOMETRY_TABLES };

typedef struct sbl__geometry {
    sbl__mesh *meshes;
    int mesh_count;
    float *lightmap_texcoords;     /* 2 floats per vertex of the scene; no elements if no mesh has them */
    float *positions, *normals;    /* in object space, 3 floats per vertex, for sbl_set_mesh_transform */
    sbl__vertex *vertices;
    sbl__attributes *attributes;
    uint32_t *indices;
    sbl__object *objects;
    int vertex_count, triangle_count;
    int colored;                   /* 1 if some mesh has vertex colours */
    float bounds[2][3];            /* lowest and highest coordinates of the scene in world space */
    double across, away;           /* diagonal of the bounds, and their largest absolute coordinate, in world units */
    float extent;                  /* across + away, or 1 if that is 0; in world units. The offsets of sensors from
                                      surfaces (see SBL__OFFSET) and the values in depth buffers are in proportion to
                                      it, and distances in the view texture are multiples of it */
    sbl__table tables[SBL__GEOMETRY_TABLES];
    unsigned vertex_array;         /* GL vertex array: position, object, texture coordinates, colour */
    int wide;                      /* 1 if the tables are 2D textures, see sbl__table */
} sbl__geometry;

static void sbl__geometry_free(const sbl__device *d, sbl__geometry *g) {
    void *const arrays[] = { g->meshes, g->positions, g->normals, g->lightmap_texcoords, g->vertices, g->attributes,
                             g->indices, g->objects };
    int i;
    for (i = 0; i < SBL__COUNT(arrays); i++) sbl__free(d->base, arrays[i]);
    sbl__array_delete(d, &g->vertex_array);
    for (i = 0; i < SBL__GEOMETRY_TABLES; i++) sbl__table_delete(d, &g->tables[i]);
    memset(g, 0, sizeof *g);
}

/* >>geometry: reading */

/* Returns the value of a component, as a double because a float cannot hold all 32-bit indices. */
static double sbl__component(const unsigned char *at, sbl_type type) {
    float f;
    uint16_t u16;
    int16_t i16;
    uint32_t u32;
    int8_t i8;
    switch (type) {
        case SBL_FLOAT32: memcpy(&f, at, 4); return f;
        case SBL_FLOAT16: memcpy(&u16, at, 2); return sbl__from_half(u16);
        case SBL_UINT8: case SBL_UINT8_NORM: return *at * sbl__types[type].scale;
        case SBL_UINT16: case SBL_UINT16_NORM: memcpy(&u16, at, 2); return u16 * sbl__types[type].scale;
        case SBL_INT8_NORM: memcpy(&i8, at, 1); return SBL__MAX(-1.0, i8 * sbl__types[type].scale);
        case SBL_INT16_NORM: memcpy(&i16, at, 2); return SBL__MAX(-1.0, i16 * sbl__types[type].scale);
        case SBL_UINT32: memcpy(&u32, at, 4); return u32;
        default: return 0;
    }
}

/* Reads the elements of a stream that has been checked. out: array of uint32_t for indices, otherwise of float */
static sbl_result sbl__stream_read(const sbl__device *d, const sbl__stream_use *use, void *out) {
    const sbl_stream *s = use->stream;
    const size_t stride = sbl__stream_stride(use);
    const size_t bytes = use->count ? stride * ((size_t)use->count - 1) + sbl__stream_element(use) : 0;
    const unsigned char *from = s->data && bytes ? (const unsigned char *)s->data + s->offset : NULL;
    void *copy = NULL;
    sbl_result result = SBL_SUCCESS;
    int i, k;
    if (s->gl_buffer && bytes) {
        copy = sbl__alloc_raw(d->base, bytes, 1);
        if (!copy) return SBL_ERROR_OUT_OF_MEMORY;
        result = sbl__host_buffer_read(d, s->gl_buffer, s->offset, bytes, copy);
        from = (const unsigned char *)copy;
    }
    for (i = 0; i < use->count && result == SBL_SUCCESS; i++)
        for (k = 0; k < use->components; k++) {
            const double x = sbl__component(from + stride * (size_t)i + k * sbl__types[s->type].bytes, s->type);
            if (use->components == 1) ((uint32_t *)out)[i] = (uint32_t)x;
            else ((float *)out)[(size_t)use->components * (size_t)i + (size_t)k] = (float)x;
        }
    sbl__free(d->base, copy);
    return result;
}

/* A mesh that has been read. values: contents of the streams, NULL for a missing stream. The texture coordinates and
   colours belong to this struct; the other values, and the corners, are parts of the arrays of sbl__geometry. */
typedef struct sbl__mesh_data {
    sbl__stream_use streams[SBL__STREAMS];
    float *values[SBL__INDICES];
    uint32_t *corners;           /* three vertex numbers per triangle, counted from the mesh's first vertex */
    int vertex_count, corner_count;
} sbl__mesh_data;

static sbl_result sbl__mesh_read(const sbl__device *d, const sbl__geometry *g, const sbl_mesh *in, sbl__mesh_data *m) {
    const int indexed = sbl__stream_present(&in->indices);
    const size_t first = (size_t)g->vertex_count;
    sbl_result result = SBL_SUCCESS;
    int i;
    memset(m, 0, sizeof *m);
    sbl__mesh_streams(in, m->streams);
    m->vertex_count = in->vertex_count;
    m->corner_count = indexed ? in->index_count : in->vertex_count;
    m->corners = g->indices + 3 * (size_t)g->triangle_count;
    for (i = 0; i < SBL__INDICES && result == SBL_SUCCESS; i++) {
        const sbl__stream_use *use = &m->streams[i];
        if (!sbl__stream_present(use->stream)) continue;
        m->values[i] = i == SBL__POSITIONS ? g->positions + 3 * first
                     : i == SBL__NORMALS   ? g->normals + 3 * first
                     : i == SBL__LIGHTMAP_TEXCOORDS ? g->lightmap_texcoords + 2 * first
                     : (float *)sbl__alloc_raw(d->base, (size_t)use->count, 4 * (size_t)use->components);
        result = m->values[i] ? sbl__stream_read(d, use, m->values[i]) : SBL_ERROR_OUT_OF_MEMORY;
    }
    if (result == SBL_SUCCESS && indexed) result = sbl__stream_read(d, &m->streams[SBL__INDICES], m->corners);
    for (i = 0; !indexed && i < m->corner_count; i++) m->corners[i] = (uint32_t)i;
    return result;
}

/* >>geometry: validating */

/* Reports the first bad component of each stream, and the first bad index. */
static void sbl__mesh_validate(sbl__check *check, const sbl__mesh_data *m) {
    int s, i;
    for (s = 0; s < SBL__INDICES; s++) {
        const sbl__stream_use *use = &m->streams[s];
        const float *range = s == SBL__COLORS ? sbl__unit_range : sbl__any_range;
        char name[64];
        for (i = 0; m->values[s] && i < use->count * use->components; i++) {
            if (sbl__between(&m->values[s][i], range[0], range[1])) continue;
            snprintf(name, sizeof name, "%s: component %d of vertex %d", use->name, i % use->components,
                     i / use->components);
            sbl__check_range(check, name, &m->values[s][i], 1, range);
            break;
        }
    }
    for (i = 0; i < m->corner_count; i++)
        if (m->corners[i] >= (uint32_t)m->vertex_count) {
            sbl__mistake(check, "indices: index %d is %u; the mesh has %d vertices", i, m->corners[i], m->vertex_count);
            return;
        }
}

/* >>geometry: converting */

static uint32_t sbl__pack_color(const float *two) {
    return (uint32_t)(two[0] * SBL__COLOR_MOST + 0.5f) | (uint32_t)(two[1] * SBL__COLOR_MOST + 0.5f) << 16;
}

/* Fills the attributes and indices of a mesh that has been read and validated. Leaves out triangles without area. */
static void sbl__mesh_convert(sbl__geometry *g, const sbl__mesh_data *m, int number) {
    static const float white[4] = { 1, 1, 1, 1 };
    const float *texcoords = m->values[SBL__TEXCOORDS], *colors = m->values[SBL__COLORS];
    sbl__mesh *mesh = &g->meshes[number];
    int v, t, i;
    mesh->first_vertex = g->vertex_count;
    mesh->vertex_count = m->vertex_count;
    mesh->first_triangle = g->triangle_count;
    mesh->lightmapped = m->values[SBL__LIGHTMAP_TEXCOORDS] != NULL;
    for (v = 0; v < m->vertex_count; v++) {
        sbl__attributes *a = &g->attributes[g->vertex_count + v];
        const float *color = colors ? colors + 4 * (size_t)v : white;
        a->u = texcoords ? texcoords[2 * (size_t)v] : 0;
        a->v = texcoords ? texcoords[2 * (size_t)v + 1] : 0;
        a->color_rg = sbl__pack_color(color);
        a->color_ba = sbl__pack_color(color + 2);
        a->unused = 0;
        g->vertices[g->vertex_count + v].object = (uint32_t)number;
    }
    for (t = 0; t < m->corner_count / 3; t++) {
        const float *p[3];
        double normal[3];
        uint32_t corners[3];
        for (i = 0; i < 3; i++) {
            corners[i] = m->corners[3 * (size_t)t + (size_t)i];
            p[i] = m->values[SBL__POSITIONS] + 3 * (size_t)corners[i];
        }
        sbl__triangle_normal(p, normal);
        if (normal[0] == 0 && normal[1] == 0 && normal[2] == 0) continue;
        for (i = 0; i < 3; i++)  /* m->corners is in g->indices, too; only corners already read are overwritten */
            g->indices[3 * (size_t)g->triangle_count + (size_t)i] = (uint32_t)g->vertex_count + corners[i];
        g->triangle_count++;
    }
    mesh->triangle_count = g->triangle_count - mesh->first_triangle;
    g->vertex_count += m->vertex_count;
    if (colors) g->colored = 1;
}

/* Reverses the winding of a mesh's triangles, because a reflection has turned their front faces to the back. */
static void sbl__mesh_reverse(sbl__geometry *g, const sbl__mesh *mesh) {
    int t;
    for (t = mesh->first_triangle; t < mesh->first_triangle + mesh->triangle_count; t++) {
        uint32_t *corners = g->indices + 3 * (size_t)t, swap = corners[1];
        corners[1] = corners[2];
        corners[2] = swap;
    }
}

/* Limit of coordinates in world space. Below it, sums of a few squared coordinates do not overflow a float. */
#define SBL__COORDINATE_MOST 1e18

/* Gives a mesh the transform m, object space to world space, instead of mesh->transform. Returns 1 on success. If a
   coordinate is not below SBL__COORDINATE_MOST, logs an error and returns 0; mesh->transform is then the old one, but
   some vertices are transformed. */
static int sbl__mesh_transform(const sbl__base *base, sbl__geometry *g, int number, const float m[16]) {
    sbl__mesh *mesh = &g->meshes[number];
    const double d = sbl__affine_determinant(m);
    double n[9], column[3][3];
    int v, i, k;
    /* Normals are transformed by the cofactor matrix n, which is the inverse transpose times the determinant. */
    for (i = 0; i < 3; i++) for (k = 0; k < 3; k++) column[i][k] = m[4 * i + k];
    for (i = 0; i < 3; i++) sbl__cross(column[(i + 1) % 3], column[(i + 2) % 3], n + 3 * i);
    for (v = mesh->first_vertex; v < mesh->first_vertex + mesh->vertex_count; v++) {
        const float *p = g->positions + 3 * (size_t)v, *q = g->normals + 3 * (size_t)v;
        float *world = g->vertices[v].position;
        double normal[3];
        for (i = 0; i < 3; i++) {
            world[i] = (float)((double)m[i] * p[0] + (double)m[4 + i] * p[1] + (double)m[8 + i] * p[2] + m[12 + i]);
            normal[i] = n[i] * q[0] + n[3 + i] * q[1] + n[6 + i] * q[2];
            if (d < 0) normal[i] = -normal[i];
        }
        for (i = 0; i < 3; i++)
            if (!(fabs((double)world[i]) < SBL__COORDINATE_MOST)) {
                sbl__log(base, SBL_LOG_ERROR, SBL_LOG_ITEM_INVALID_MESH, "mesh %d: vertex %d is at %g %g %g in world "
                         "space; coordinates must be between -1e18 and 1e18", number, v - mesh->first_vertex,
                         (double)world[0], (double)world[1], (double)world[2]);
                return 0;
            }
        if (!sbl__normalize(normal)) normal[0] = normal[1] = normal[2] = 0;  /* shaders then use the face's normal */
        for (i = 0; i < 3; i++) g->attributes[v].normal[i] = (float)normal[i];
    }
    if ((d < 0) != (sbl__affine_determinant(mesh->transform) < 0)) sbl__mesh_reverse(g, mesh);
    memmove(mesh->transform, m, sizeof mesh->transform);
    return 1;
}

/* Reads, validates and converts mesh `number` of the scene and transforms it to world space. Reports all mistakes. */
static sbl_result sbl__geometry_add(const sbl__device *d, sbl__geometry *g, const sbl_mesh *in, int number) {
    float *transform = g->meshes[number].transform;
    sbl__mesh_data data;
    sbl__check check = { d->base, d, SBL_LOG_ITEM_INVALID_MESH, "", 0 };
    sbl_result result = sbl__mesh_read(d, g, in, &data);
    if (result == SBL_SUCCESS) {
        sbl__check_object(&check, SBL_LOG_ITEM_INVALID_MESH, "mesh", number);
        sbl__mesh_validate(&check, &data);
        result = sbl__check_end(&check);
    }
    if (result == SBL_SUCCESS) {
        sbl__mesh_convert(g, &data, number);
        sbl__identity(transform);
        if (!sbl__mesh_transform(d->base, g, number, sbl__all_zero(in->transform, 16) ? transform : in->transform))
            result = SBL_ERROR_INVALID_ARGUMENT;
    }
    sbl__free(d->base, data.values[SBL__TEXCOORDS]);
    sbl__free(d->base, data.values[SBL__COLORS]);
    return result;
}

/* Adds all meshes of a descriptor that has been checked. */
static sbl_result sbl__geometry_make(const sbl__device *d, sbl__geometry *g, const sbl_scene_desc *desc) {
    double vertices = 0, triangles = 0;
    sbl_result result = SBL_SUCCESS;
    int i, lightmapped = 0;
    for (i = 0; i < desc->mesh_count; i++) {
        const sbl_mesh *m = &desc->meshes[i];
        vertices += m->vertex_count;
        lightmapped |= sbl__stream_present(&m->lightmap_texcoords);
        triangles += (sbl__stream_present(&m->indices) ? m->index_count : m->vertex_count) / 3;
    }
    if (vertices > INT_MAX / 4 || triangles > INT_MAX / 4) {
        sbl__log(d->base, SBL_LOG_ERROR, SBL_LOG_ITEM_TOO_LARGE, "the scene has %.0f vertices and %.0f triangles; it "
                 "may have at most %d of each", vertices, triangles, INT_MAX / 4);
        return SBL_ERROR_UNSUPPORTED;
    }
    g->mesh_count = desc->mesh_count;
    g->meshes = (sbl__mesh *)sbl__alloc(d->base, (size_t)desc->mesh_count, sizeof(sbl__mesh));
    g->positions = (float *)sbl__alloc(d->base, (size_t)vertices, 12);
    g->normals = (float *)sbl__alloc(d->base, (size_t)vertices, 12);
    g->vertices = (sbl__vertex *)sbl__alloc(d->base, (size_t)vertices, sizeof(sbl__vertex));
    g->attributes = (sbl__attributes *)sbl__alloc(d->base, (size_t)vertices, sizeof(sbl__attributes));
    g->indices = (uint32_t *)sbl__alloc(d->base, (size_t)triangles, 12);
    g->objects = (sbl__object *)sbl__alloc(d->base, (size_t)desc->mesh_count, sizeof(sbl__object));
    g->lightmap_texcoords = (float *)sbl__alloc(d->base, lightmapped ? (size_t)vertices : 0, 8);
    if (!g->meshes || !g->positions || !g->normals || !g->vertices || !g->attributes || !g->indices || !g->objects ||
        !g->lightmap_texcoords)
        return SBL_ERROR_OUT_OF_MEMORY;
    for (i = 0; i < desc->mesh_count; i++) {  /* goes on after mistakes, to log the mistakes of all meshes */
        const sbl_result mesh = sbl__geometry_add(d, g, &desc->meshes[i], i);
        if (mesh == SBL_SUCCESS) continue;
        result = mesh;
        if (mesh != SBL_ERROR_INVALID_ARGUMENT) break;
    }
    if (result == SBL_SUCCESS && triangles > g->triangle_count)
        sbl__log(d->base, SBL_LOG_WARNING, SBL_LOG_ITEM_DEGENERATE_TRIANGLES, "%.0f of %.0f triangles have no area and "
                 "were left out", triangles - g->triangle_count, triangles);
    return result;
}

/* Computes the scene's bounds and sizes. drawn: bounds of what the host draws itself; NULL if it draws nothing */
static void sbl__geometry_measure(sbl__geometry *g, const float (*drawn)[3]) {
    int i, k;
    g->across = g->away = 0;
    for (k = 0; k < 3; k++) {
        g->bounds[0][k] = drawn ? drawn[0][k] : FLT_MAX;
        g->bounds[1][k] = drawn ? drawn[1][k] : -FLT_MAX;
    }
    for (i = 0; i < 3 * g->triangle_count; i++) {
        const float *p = g->vertices[g->indices[i]].position;
        for (k = 0; k < 3; k++) {
            g->bounds[0][k] = SBL__MIN(g->bounds[0][k], p[k]);
            g->bounds[1][k] = SBL__MAX(g->bounds[1][k], p[k]);
        }
    }
    if (!drawn && !g->triangle_count) memset(g->bounds, 0, sizeof g->bounds);
    for (k = 0; k < 3; k++) {
        const double low = g->bounds[0][k], high = g->bounds[1][k];
        g->across += (high - low) * (high - low);
        g->away = SBL__MAX(g->away, SBL__MAX(fabs(low), fabs(high)));
    }
    g->across = sqrt(g->across);
    g->extent = (float)(g->across + g->away);
    if (!(g->extent > 0)) g->extent = 1;
}

/* Makes the contents of all tables' buffers visible to shaders. */
static sbl_result sbl__geometry_attach(const sbl__device *d, sbl__geometry *g) {
    sbl_result result = SBL_SUCCESS;
    int i;
    for (i = 0; i < SBL__GEOMETRY_TABLES && result == SBL_SUCCESS; i++)
        result = sbl__table_attach(d, &g->tables[i], i == SBL__INDEX_TABLE ? SBL__GL_R32UI : SBL__GL_RGBA32UI, g->wide);
    return result;
}

/* Sends all objects to the GPU after materials have changed. */
static sbl_result sbl__geometry_attach_objects(const sbl__device *d, sbl__geometry *g) {
    sbl__table *objects = &g->tables[SBL__OBJECT_TABLE];
    sbl__buffer_write(d, &objects->buffer, 0, sizeof(sbl__object) * (size_t)g->mesh_count, g->objects);
    return sbl__table_attach(d, objects, SBL__GL_RGBA32UI, g->wide);
}

/* The vertex attributes that sensor_vertex.glsl declares. */
static const sbl__input sbl__vertex_inputs[] = {
    { 0, 3, SBL__GL_FLOAT, 0, 0, sizeof(sbl__vertex), offsetof(sbl__vertex, position) },
    { 1, 1, SBL__GL_UNSIGNED_INT, 1, 0, sizeof(sbl__vertex), offsetof(sbl__vertex, object) }
};
static const sbl__input sbl__attribute_inputs[] = {
    { 2, 2, SBL__GL_FLOAT, 0, 0, sizeof(sbl__attributes), 12 },  /* u and v, which follow the 12 bytes of the normal */
    { 3, 2, SBL__GL_UNSIGNED_INT, 1, 0, sizeof(sbl__attributes), offsetof(sbl__attributes, color_rg) }
};

static sbl_result sbl__geometry_upload(const sbl__device *d, sbl__geometry *g) {
    const void *const contents[] = { g->vertices, g->attributes, g->indices, g->objects };
    const size_t bytes[] = { sizeof *g->vertices * (size_t)g->vertex_count,
                             sizeof *g->attributes * (size_t)g->vertex_count,
                             sizeof *g->indices * 3 * (size_t)g->triangle_count,
                             sizeof *g->objects * (size_t)g->mesh_count };
    sbl_result result = SBL_SUCCESS;
    int i;
    for (i = 0; i < SBL__GEOMETRY_TABLES && result == SBL_SUCCESS; i++)
        result = sbl__buffer_make(d, &g->tables[i].buffer, bytes[i], contents[i], SBL__GL_STATIC_DRAW);
    if (result == SBL_SUCCESS) result = sbl__geometry_attach(d, g);
    if (result == SBL_SUCCESS) result = sbl__array_make(d, &g->vertex_array, &g->tables[SBL__INDEX_TABLE].buffer);
    if (result != SBL_SUCCESS) return result;
    sbl__array_inputs(d, g->vertex_array, &g->tables[SBL__POSITION_TABLE].buffer, sbl__vertex_inputs, 2);
    sbl__array_inputs(d, g->vertex_array, &g->tables[SBL__ATTRIBUTE_TABLE].buffer, sbl__attribute_inputs, 2);
    return sbl__gl_check(&d->gl);
}

/* Gives a mesh another transform, in the arrays and on the GPU. Changes nothing if sbl__mesh_transform refuses it. */
static sbl_result sbl__geometry_move(const sbl__device *d, sbl__geometry *g, int number, const float transform[16]) {
    const sbl__mesh *mesh = &g->meshes[number];
    const size_t first = (size_t)mesh->first_vertex, count = (size_t)mesh->vertex_count;
    const size_t corners = 3 * (size_t)mesh->first_triangle;
    if (!sbl__mesh_transform(d->base, g, number, transform)) {
        sbl__mesh_transform(d->base, g, number, mesh->transform);
        return SBL_ERROR_INVALID_ARGUMENT;
    }
    sbl__buffer_write(d, &g->tables[SBL__POSITION_TABLE].buffer, sizeof *g->vertices * first,
                      sizeof *g->vertices * count, g->vertices + first);
    sbl__buffer_write(d, &g->tables[SBL__ATTRIBUTE_TABLE].buffer, sizeof *g->attributes * first,
                      sizeof *g->attributes * count, g->attributes + first);
    sbl__buffer_write(d, &g->tables[SBL__INDEX_TABLE].buffer, 4 * corners, 12 * (size_t)mesh->triangle_count,
                      g->indices + corners);
    return g->wide ? sbl__geometry_attach(d, g) : sbl__gl_check(&d->gl);
}

static const sbl__object *sbl__triangle_object(const sbl__geometry *g, uint32_t triangle) {
    return &g->objects[g->vertices[g->indices[3 * (size_t)triangle]].object];
}

static const float *sbl__triangle_corner(const sbl__geometry *g, uint32_t triangle, int corner) {
    return g->vertices[g->indices[3 * (size_t)triangle + (size_t)corner]].position;
}

static void sbl__scene_triangle(const sbl__geometry *g, uint32_t triangle, const float *corners[3]) {
    int k;
    for (k = 0; k < 3; k++) corners[k] = sbl__triangle_corner(g, triangle, k);
}

/* Computes the unit normal of a triangle, or 0 0 0 if the triangle has no area. Returns the area. */
static double sbl__scene_normal(const sbl__geometry *g, uint32_t triangle, double normal[3]) {
    const float *corners[3];
    double area;
    sbl__scene_triangle(g, triangle, corners);
    sbl__triangle_normal(corners, normal);
    area = 0.5 * sqrt(normal[0] * normal[0] + normal[1] * normal[1] + normal[2] * normal[2]);
    if (!sbl__normalize(normal)) normal[0] = normal[1] = normal[2] = 0;
    return area;
}

static void sbl__geometry_bind(sbl__device *d, const sbl__geometry *g) {
    static const char *const names[] = { "sbl_positions", "sbl_attributes", "sbl_indices", "sbl_objects" };
    int i;
    for (i = 0; i < SBL__GEOMETRY_TABLES; i++) sbl__bind_table(d, names[i], &g->tables[i]);
}

/* ==================================================================================================== >>topology
   Connectivity of triangles: hash tables that find vertices at equal positions and shared sides, groups, and values
   that spread from neighbour to neighbour. Callers number vertices and triangles themselves. The number of a side is
   3 * triangle + the corner at which it begins. */

#define SBL__NONE UINT32_MAX

/* Hash table of numbers, with linear probing. Numbers with equal hashes are found in the order of insertion. */
typedef struct sbl__hash_table {
    uint32_t *slots;  /* 1 + number; 0: free */
    uint32_t mask;    /* number of slots, which is a power of two, minus 1 */
} sbl__hash_table;

static void sbl__hash_table_free(sbl__base *base, sbl__hash_table *t) {
    sbl__free(base, t->slots);
    t->slots = NULL;
}

/* Makes the table empty, with room for `count` numbers. */
static sbl_result sbl__hash_table_make(sbl__base *base, sbl__hash_table *t, double count) {
    uint32_t slots = 16;
    while (slots < 2 * count && slots < 0x80000000u) slots *= 2;
    sbl__hash_table_free(base, t);
    t->slots = (uint32_t *)sbl__alloc(base, slots, sizeof *t->slots);
    t->mask = slots - 1;
    return t->slots ? SBL_SUCCESS : SBL_ERROR_OUT_OF_MEMORY;
}

/* Returns the number in *slot and advances *slot, so that a loop that begins with *slot = hash finds all numbers with
   this hash, and a few others. Returns SBL__NONE at the end; *slot is then free. */
static uint32_t sbl__slot_next(const sbl__hash_table *t, uint32_t *slot) {
    const uint32_t found = t->slots[*slot & t->mask];
    *slot += found > 0;
    return found - 1;
}

static void sbl__slot_fill(sbl__hash_table *t, uint32_t slot, uint32_t number) {
    t->slots[slot & t->mask] = number + 1;
}

/* Returns the first number with this hash for which `same` is true. If there is none, inserts and returns `number`. */
static uint32_t sbl__hash_table_first(sbl__hash_table *t, uint32_t hash, uint32_t number,
                                      int (*same)(const void *user, uint32_t one, uint32_t other), const void *user) {
    uint32_t slot = hash, other;
    while ((other = sbl__slot_next(t, &slot)) != SBL__NONE)
        if (same(user, number, other)) return other;
    sbl__slot_fill(t, slot, number);
    return number;
}

/* Floats are hashed and compared by value: -0 equals 0. */
static uint32_t sbl__hash_floats(uint32_t hash, const float *x, int count) {
    int k;
    for (k = 0; k < count; k++) hash = sbl__hash(hash ^ (sbl__zero(x + k) ? 0 : sbl__float_bits(x + k)));
    return hash;
}

static int sbl__same_floats(const float *a, const float *b, int count) {
    int k;
    for (k = 0; k < count; k++) if (a[k] < b[k] || b[k] < a[k]) return 0;
    return 1;
}

/* Hashes the place of a vertex. Vertices are at the same place if they belong to one mesh and their positions are
   equal. */
static uint32_t sbl__place_hash(const sbl__geometry *g, uint32_t vertex) {
    return sbl__hash_floats(g->vertices[vertex].object, g->vertices[vertex].position, 3);
}

static int sbl__same_place(const void *geometry, uint32_t one, uint32_t other) {
    const sbl__vertex *v = ((const sbl__geometry *)geometry)->vertices;
    return v[one].object == v[other].object && sbl__same_floats(v[one].position, v[other].position, 3);
}

/* Returns a vertex of a side. which: 0, 1: an end; 2: the opposite corner. corners: 3 welded vertices per triangle */
static uint32_t sbl__side_end(const uint32_t *corners, uint32_t side, uint32_t which) {
    return corners[side - side % 3 + (side + which) % 3];
}

static int sbl__same_ends(const void *corners, uint32_t one, uint32_t other) {
    const uint32_t *all = (const uint32_t *)corners;
    const uint32_t a = sbl__side_end(all, one, 0), b = sbl__side_end(all, one, 1);
    const uint32_t c = sbl__side_end(all, other, 0), d = sbl__side_end(all, other, 1);
    return (a == c && b == d) || (a == d && b == c);
}

/* Returns the first side with the same ends, in either order. If there is none, inserts and returns `side`. */
static uint32_t sbl__first_side(sbl__hash_table *t, const uint32_t *corners, uint32_t side) {
    const uint32_t a = sbl__side_end(corners, side, 0), b = sbl__side_end(corners, side, 1);
    return sbl__hash_table_first(t, sbl__hash(SBL__MIN(a, b) ^ sbl__hash(SBL__MAX(a, b))), side, sbl__same_ends,
                                 corners);
}

/* Union-find: returns the root of a number's tree, which is the least number of its group. */
static uint32_t sbl__root(uint32_t *parents, uint32_t number) {
    while (parents[number] != number) number = parents[number] = parents[parents[number]];
    return number;
}

/* Merges the groups of two numbers. */
static void sbl__join(uint32_t *parents, uint32_t one, uint32_t other) {
    one = sbl__root(parents, one);
    other = sbl__root(parents, other);
    parents[SBL__MAX(one, other)] = SBL__MIN(one, other);
}

/* >>topology: rings. Values spread to things of a grid (pixels or texels) that have none. Ring 0 holds the things that
   have a value from the start, ring 1 their neighbours, ring 2 the neighbours of ring 1, and so on. A thing's value is
   computed from the values of its neighbours in earlier rings. */

#define SBL__RING_WAITS (-1)

typedef struct sbl__rings {
    sbl__stages stages;
    void *user;
    int (*joined)(const void *user, int thing, int other);  /* 0: `thing` gives no value to `other`. NULL: all do */
    void (*mean)(void *user, int thing);  /* sets the value of `thing` from neighbours that sbl__ring_reached accepts */
    int count;          /* number of things */
    int width;          /* things per row of the grid */
    int last;           /* last ring to compute */
    int *ring;          /* ring of each thing; SBL__RING_WAITS until it is known */
    int *queue;         /* things of rings 1 .. last, in the order of the rings; the second half of `ring` */
    int queued;         /* number of things that have been added to the queue */
    int number;         /* number of the ring that is being computed */
} sbl__rings;

static void sbl__rings_free(sbl__base *base, sbl__rings *r) {
    sbl__free(base, r->ring);
    memset(r, 0, sizeof *r);
}

/* Allocates r->ring and fills it with SBL__RING_WAITS. The caller then sets the fields from `user` to `last`, and
   r->ring of things that have a value to 0. */
static sbl_result sbl__rings_make(sbl__base *base, sbl__rings *r, int count) {
    r->count = count;
    r->ring = (int *)sbl__alloc_raw(base, (size_t)count, 2 * sizeof *r->ring);
    if (!r->ring) return SBL_ERROR_OUT_OF_MEMORY;
    memset(r->ring, 0xff, (size_t)count * sizeof *r->ring);
    r->queue = r->ring + count;
    return SBL_SUCCESS;
}

static int sbl__ring_reached(const sbl__rings *r, int thing) {
    return r->ring[thing] >= 0 && r->ring[thing] < r->number;
}

/* Iterates over the 3 x 3 block around a thing, including the thing itself, row by row. *place must be 0 at first. -1:
   there are no more things. */
static int sbl__ring_grid(const sbl__rings *r, int thing, size_t *place) {
    while (*place < 9) {
        const int x = thing % r->width + (int)(*place % 3) - 1, y = thing / r->width + (int)(*place / 3) - 1;
        ++*place;
        if (x >= 0 && y >= 0 && x < r->width && y < r->count / r->width) return y * r->width + x;
    }
    return -1;
}

/* Appends a thing's waiting neighbours to the queue. They belong to the next ring. */
static void sbl__ring_spread(sbl__rings *r, int thing) {
    size_t place = 0;
    int other;
    while (r->number < r->last && (other = sbl__ring_grid(r, thing, &place)) >= 0) {
        if (r->ring[other] != SBL__RING_WAITS || (r->joined && !r->joined(r->user, thing, other))) continue;
        r->queue[r->queued++] = other;
        r->ring[other] = r->number + 1;
    }
}

static sbl_result sbl__ring_source(void *work, int thing) {
    sbl__rings *r = (sbl__rings *)work;
    if (r->ring[thing] == 0) sbl__ring_spread(r, thing);
    return SBL_SUCCESS;
}

static sbl_result sbl__ring_next(void *work, int at) {
    sbl__rings *r = (sbl__rings *)work;
    const int thing = r->queue[at];
    r->number = r->ring[thing];
    r->mean(r->user, thing);
    sbl__ring_spread(r, thing);
    return SBL_SUCCESS;
}

static int sbl__rings_things(void *work) { return ((sbl__rings *)work)->count; }
static int sbl__rings_queued(void *work) { return ((sbl__rings *)work)->queued; }

/* Does a piece of the work. Returns SBL_SUCCESS when all rings up to r->last have their values. */
static sbl_result sbl__rings_step(sbl__rings *r, sbl__slice *slice) {
    static const sbl__stage_row table[] = {
        { NULL, NULL, sbl__ring_source, sbl__rings_things },
        { NULL, NULL, sbl__ring_next, sbl__rings_queued }
    };
    return sbl__stages_step(&r->stages, table, SBL__COUNT(table), r, slice);
}

/* ====================================================================================================== >>solver
   Solves the normal equations of least-squares problems, for three channels at once, by conjugate gradients with a
   diagonal preconditioner (Shewchuk 1994, "An Introduction to the Conjugate Gradient Method Without the Agonizing
   Pain"). The matrix is the sum of terms, which a function of the caller multiplies by a direction, and of a multiple
   of the identity. */

#define SBL__SOLVER_ROUNDS 1000  /* limit of the number of iterations */

enum { SBL__SOLVER_START, SBL__SOLVER_TURN, SBL__SOLVER_MULTIPLY, SBL__SOLVER_DOT, SBL__SOLVER_ADVANCE,
       SBL__SOLVER_DONE };

/* The scalars of a system. power, next_power: residual . preconditioned residual, before and after the iteration.
   along: direction . product. first2, left2: squared length of the preconditioned residual, at the start and after the
   iteration. turn: factor of the last direction in the next direction */
typedef struct sbl__solver_sums { double power, next_power, along, first2, left2, turn; } sbl__solver_sums;

typedef struct sbl__solver {
    sbl__stages stages;
    void *user;
    void (*term)(void *user, int i, const double *direction, double *product);  /* product += term i * direction */
    int term_count;
    int count;                  /* number of unknowns */
    int together;               /* 1: the equations couple the three channels; 0: each channel is solved by itself */
    double identity;            /* factor of the identity in the matrix */
    double precision2;          /* a system is solved when left2 / first2 is at most this */
    /* Arrays of three numbers per unknown, one for each channel. They share one block of memory. */
    double *diagonal;           /* the preconditioner: diagonal of the matrix, or all 1. An unknown whose entry is 0
                                   keeps its value */
    double *solution;           /* must be 0 at the start */
    double *residual;           /* must be the right-hand side of the equations at the start */
    double *direction, *product;  /* search direction; matrix * direction */
    sbl__solver_sums sums[3];
    int rounds;
} sbl__solver;

static void sbl__solver_free(sbl__base *base, sbl__solver *s) {
    sbl__free(base, s->diagonal);
    memset(s, 0, sizeof *s);
}

/* Makes the arrays, filled with 0. */
static sbl_result sbl__solver_make(sbl__base *base, sbl__solver *s, int count) {
    const size_t length = 3 * (size_t)count;
    s->count = count;
    s->diagonal = (double *)sbl__alloc(base, 5 * length, sizeof(double));
    if (!s->diagonal) return SBL_ERROR_OUT_OF_MEMORY;
    s->solution = s->diagonal + length;
    s->residual = s->solution + length;
    s->direction = s->residual + length;
    s->product = s->direction + length;
    return SBL_SUCCESS;
}

static int sbl__solver_unknowns(void *work) { return ((sbl__solver *)work)->count; }
static int sbl__solver_terms(void *work) { return ((sbl__solver *)work)->term_count; }

static sbl_result sbl__solver_term(void *work, int term) {
    sbl__solver *s = (sbl__solver *)work;
    s->term(s->user, term, s->direction, s->product);
    return SBL_SUCCESS;
}

/* Processes an unknown, in any stage except SBL__SOLVER_MULTIPLY. */
static sbl_result sbl__solver_unknown(void *work, int unknown) {
    sbl__solver *s = (sbl__solver *)work;
    size_t i = 3 * (size_t)unknown;
    int k;
    for (k = 0; k < 3; k++, i++) {
        sbl__solver_sums *sum = &s->sums[s->together ? 0 : k];
        const double d = s->diagonal[i], preconditioned = d > 0 ? s->residual[i] / d : 0;
        const double share = sum->along > 0 ? sum->power / sum->along : 0;
        switch (s->stages.stage) {
            case SBL__SOLVER_START:
                sum->power += s->residual[i] * preconditioned;
                sum->first2 += preconditioned * preconditioned;
                break;
            case SBL__SOLVER_TURN:
                s->direction[i] = preconditioned + sum->turn * s->direction[i];
                s->product[i] = s->identity * s->direction[i];
                break;
            case SBL__SOLVER_DOT: sum->along += s->direction[i] * s->product[i]; break;
            default:
                if (!(d > 0)) break;
                s->solution[i] += share * s->direction[i];
                s->residual[i] -= share * s->product[i];
                sum->next_power += s->residual[i] * s->residual[i] / d;
                sum->left2 += s->residual[i] / d * (s->residual[i] / d);
        }
    }
    return SBL_SUCCESS;
}

static int sbl__solver_after_start(void *work) {
    const sbl__solver_sums *sums = ((const sbl__solver *)work)->sums;
    return sums[0].first2 > 0 || sums[1].first2 > 0 || sums[2].first2 > 0 ? SBL__SOLVER_TURN : SBL__SOLVER_DONE;
}

static int sbl__solver_after_advance(void *work) {
    sbl__solver *s = (sbl__solver *)work;
    int k, solved = 1;
    for (k = 0; k < 3; k++) {
        sbl__solver_sums *sum = &s->sums[k];
        solved &= sum->left2 <= s->precision2 * sum->first2;
        sum->turn = sum->power > 0 ? sum->next_power / sum->power : 0;
        sum->power = sum->next_power;
        sum->next_power = sum->along = sum->left2 = 0;
    }
    return solved || ++s->rounds >= SBL__SOLVER_ROUNDS ? SBL__SOLVER_DONE : SBL__SOLVER_TURN;
}

/* Does a piece of the work. Returns SBL_SUCCESS when the solution is ready; the next call then starts anew. */
static sbl_result sbl__solver_step(sbl__solver *s, sbl__slice *slice) {
    static const sbl__stage_row table[] = {
        { NULL, sbl__solver_after_start, sbl__solver_unknown, sbl__solver_unknowns },
        { NULL, NULL, sbl__solver_unknown, sbl__solver_unknowns },
        { NULL, NULL, sbl__solver_term, sbl__solver_terms },
        { NULL, NULL, sbl__solver_unknown, sbl__solver_unknowns },
        { NULL, sbl__solver_after_advance, sbl__solver_unknown, sbl__solver_unknowns }
    };
    const sbl_result result = sbl__stages_step(&s->stages, table, SBL__COUNT(table), s, slice);
    if (result != SBL_SUCCESS) return result;
    memset(&s->stages, 0, sizeof s->stages);
    memset(s->sums, 0, sizeof s->sums);
    s->rounds = 0;
    return result;
}

/* ======================================================================================================== >>textures
   All textures of the scene share two GL textures, the texel tables: one of 8-bit sRGB for textures that the host gives
   in that format, and one of 16-bit floats for all others. A texture begins at the start of a table's row; its texels
   follow each other without gaps, whatever its width. scene.glsl filters them bilinearly. */

#define SBL__TEXEL_TABLE_WIDTH 4096  /* texels per row; less if the driver's textures are smaller */

typedef struct sbl__textures {
    sbl__texture tables[2];    /* texel tables: [0] 8-bit sRGB, [1] 16-bit floats */
    /* Materials number textures from 1. Element 0 of the arrays stands for no texture. */
    uint32_t (*places)[4];     /* per texture: first row in its table, width, height, SBL__TEXTURE flags */
    float *brightest;          /* per texture: largest component of its texels; 1 if 8-bit sRGB in client memory */
    int count;
    uint64_t hash;             /* hash of both tables' texels */
} sbl__textures;

static void sbl__textures_free(const sbl__device *d, sbl__textures *t) {
    sbl__texture_delete(d, &t->tables[0]);
    sbl__texture_delete(d, &t->tables[1]);
    sbl__free(d->base, t->places);
    sbl__free(d->base, t->brightest);
    memset(t, 0, sizeof *t);
}

/* A texel table while the CPU fills it. texel: bytes per texel, 4 for 8-bit sRGB or 8 for 16-bit floats */
typedef struct sbl__texel_table { unsigned char *bytes; size_t texel; int width, rows; } sbl__texel_table;

/* Reads a pixel. Bytes are divided by 255. One channel is grey, two are grey and alpha. Without alpha, c[3] is left
   as it was. */
static void sbl__read_pixel(const sbl_texture *t, int x, int y, float c[4]) {
    const int channels = sbl__texture_channels(t);
    const unsigned char *at = (const unsigned char *)t->pixels + (size_t)y * sbl__texture_stride(t, t->width) +
                              (size_t)x * sbl__texture_pixel_bytes(t);
    int k;
    if (t->format == SBL_PIXELS_FLOAT) memcpy(c, at, 4 * (size_t)channels);
    else for (k = 0; k < channels; k++) c[k] = (float)at[k] / 255.0f;
    if (channels == 2) c[3] = c[1];
    if (channels < 3) c[1] = c[2] = c[0];
}

/* Writes the texels of a texture into its table. copy: NULL, or the r g b a that were read from the host's GL texture.
   Bytes in 8-bit sRGB stay as they are; GL decodes them when shaders read. Logs an error and returns
   SBL_ERROR_INVALID_ARGUMENT if a component is negative or not finite. */
static sbl_result sbl__texels_write(const sbl__device *d, const sbl__textures *s, const sbl__texel_table *table,
                                    const sbl_texture *t, int number, const float *copy) {
    const int width = (int)s->places[number][1], height = (int)s->places[number][2];
    const int encoded = !copy && t->format == SBL_PIXELS_SRGB8;
    unsigned char *to = table->bytes + (size_t)s->places[number][0] * (size_t)table->width * table->texel;
    int x, y, k;
    for (y = 0; y < height; y++)
        for (x = 0; x < width; x++, to += table->texel) {
            float c[4] = { 0, 0, 0, 1 };
            if (copy) memcpy(c, copy + 4 * ((size_t)y * (size_t)width + (size_t)x), sizeof c);
            else sbl__read_pixel(t, x, y, c);
            for (k = 0; k < 4; k++) {
                if (!sbl__between(&c[k], 0, FLT_MAX)) {
                    sbl__log(d->base, SBL_LOG_ERROR, SBL_LOG_ITEM_INVALID_TEXTURE, "texture %d: component %d of pixel "
                             "%d %d is %g; it must be finite and not negative", number, k, x, y, (double)c[k]);
                    return SBL_ERROR_INVALID_ARGUMENT;
                }
                if (table->texel == 8) {
                    const uint16_t half = sbl__to_half(c[k]);
                    memcpy(to + 2 * k, &half, 2);
                } else to[k] = sbl__to_byte(encoded || k == 3 ? c[k] : sbl__linear_to_srgb(c[k]));
            }
            s->brightest[number] = SBL__MAX(s->brightest[number], encoded ? 1.0f : sbl__max3(c));
        }
    return SBL_SUCCESS;
}

static sbl_result sbl__textures_fill(sbl__device *d, const sbl__textures *s, const sbl__texel_table *table,
                                     const sbl_texture *t, int number) {
    const int size[2] = { (int)s->places[number][1], (int)s->places[number][2] };
    float *copy = NULL;
    sbl_result result = SBL_SUCCESS;
    if (t->gl_texture) {
        copy = (float *)sbl__alloc_raw(d->base, (size_t)size[0] * (size_t)size[1], 16);
        if (!copy) return SBL_ERROR_OUT_OF_MEMORY;
        d->gl.doing = "reading a GL texture";
        result = sbl__host_texture_read(d, t->gl_texture, size, copy);
    }
    if (result == SBL_SUCCESS) result = sbl__texels_write(d, s, table, t, number, copy);
    sbl__free(d->base, copy);
    return result;
}

/* Assigns rows of a texel table to a texture. */
static sbl_result sbl__textures_place(sbl__device *d, sbl__textures *s, sbl__texel_table *table, const sbl_texture *t,
                                      int number) {
    const int most = d->gl.capabilities.max_texture_size;
    int size[2] = { t->width, t->height };
    double rows;
    if (t->gl_texture) {
        sbl_result result;
        d->gl.doing = "querying a GL texture";
        result = sbl__host_texture_size(d, t->gl_texture, size);
        if (result == SBL_ERROR_OUT_OF_MEMORY) return result;
        if (result != SBL_SUCCESS || size[0] < 1 || size[1] < 1) {
            sbl__log(d->base, SBL_LOG_ERROR, SBL_LOG_ITEM_INVALID_TEXTURE, "texture %d: gl_texture %u is not a "
                     "GL_TEXTURE_2D with pixels in level 0", number, t->gl_texture);
            return SBL_ERROR_INVALID_ARGUMENT;
        }
    }
    rows = ceil((double)size[0] * size[1] / table->width);
    if (table->rows + rows > most) {
        sbl__log(d->base, SBL_LOG_ERROR, SBL_LOG_ITEM_TOO_LARGE, "texture %d: all textures together need more than "
                 "%d x %d texels; use smaller textures", number, table->width, most);
        return SBL_ERROR_UNSUPPORTED;
    }
    s->places[number][0] = (uint32_t)table->rows;
    s->places[number][1] = (uint32_t)size[0];
    s->places[number][2] = (uint32_t)size[1];
    s->places[number][3] = (table->texel == 8 ? SBL__TEXTURE_FLOAT : SBL__TEXTURE_SRGB) |
                          (t->wrap == SBL_WRAP_CLAMP ? SBL__TEXTURE_CLAMPS : 0);
    table->rows += (int)rows;
    return SBL_SUCCESS;
}

/* Makes a texel table. kind: 0: 8-bit sRGB, 1: 16-bit floats */
static sbl_result sbl__texel_table_make(sbl__device *d, sbl__textures *s, const sbl_scene_desc *desc, int kind) {
    const unsigned format = kind ? SBL__GL_RGBA16F : SBL__GL_SRGB8_ALPHA8;
    sbl__texel_table table;
    sbl_result result = SBL_SUCCESS;
    int i;
    memset(&table, 0, sizeof table);
    table.texel = kind ? 8 : 4;
    table.width = SBL__MIN(SBL__TEXEL_TABLE_WIDTH, d->gl.capabilities.max_texture_size);
    for (i = 0; i < s->count && result == SBL_SUCCESS; i++)
        if ((desc->textures[i].format != SBL_PIXELS_SRGB8) == kind)
            result = sbl__textures_place(d, s, &table, &desc->textures[i], i + 1);
    if (result != SBL_SUCCESS || !table.rows) return result;
    table.bytes = (unsigned char *)sbl__alloc(d->base, (size_t)table.rows * (size_t)table.width, table.texel);
    if (!table.bytes) return SBL_ERROR_OUT_OF_MEMORY;
    for (i = 0; i < s->count && result == SBL_SUCCESS; i++)
        if ((desc->textures[i].format != SBL_PIXELS_SRGB8) == kind)
            result = sbl__textures_fill(d, s, &table, &desc->textures[i], i + 1);
    s->hash = sbl__hash_bytes(s->hash, table.bytes, (size_t)table.rows * (size_t)table.width * table.texel);
    d->gl.doing = "storing textures";
    if (result == SBL_SUCCESS) result = sbl__texture_make(d, &s->tables[kind], table.width, table.rows, format);
    if (result == SBL_SUCCESS) result = sbl__texture_write(d, &s->tables[kind], 0, table.rows, table.bytes);
    sbl__free(d->base, table.bytes);
    return result;
}

/* Makes the texel tables for all textures of a descriptor that has been checked. */
static sbl_result sbl__textures_make(sbl__device *d, sbl__textures *s, const sbl_scene_desc *desc) {
    sbl_result result;
    s->count = desc->texture_count;
    s->places = (uint32_t (*)[4])sbl__alloc(d->base, (size_t)s->count + 1, sizeof *s->places);
    s->brightest = (float *)sbl__alloc(d->base, (size_t)s->count + 1, sizeof(float));
    if (!s->places || !s->brightest) return SBL_ERROR_OUT_OF_MEMORY;
    s->brightest[0] = 1;
    result = sbl__texel_table_make(d, s, desc, 0);
    return result == SBL_SUCCESS ? sbl__texel_table_make(d, s, desc, 1) : result;
}

/* ======================================================================================================== >>material
   How surfaces emit and reflect light, and where they have holes. Materials are read only here, for the CPU, and in
   material.glsl, for shaders. Both compute the same. */

/* Copies a material into its mesh's object, and raises *brightest to an upper limit of the radiance that it emits:
   its largest component, times that of the texture. Returns the features that programs need for the material. */
static unsigned sbl__material_write(const sbl__textures *t, const sbl_material *m, sbl__object *o, float *brightest) {
    memcpy(o->albedo, m->albedo, sizeof o->albedo);
    memcpy(o->emission, m->emission, sizeof o->emission);
    memcpy(o->albedo_texture, t->places[m->albedo_texture], sizeof o->albedo_texture);
    memcpy(o->emission_texture, t->places[m->emission_texture], sizeof o->emission_texture);
    o->alpha_cutoff = m->alpha_cutoff;
    o->flags = m->flags;
    *brightest = SBL__MAX(*brightest, t->brightest[m->emission_texture] * sbl__max3(m->emission));
    if (m->alpha_cutoff > 0) return SBL__TEXTURED | SBL__CUTOUTS;
    return m->albedo_texture || m->emission_texture ? (unsigned)SBL__TEXTURED : 0;
}

/* True if two objects of one mesh differ in anything but the light that they emit. */
static int sbl__reflection_differs(const sbl__object *a, const sbl__object *b) {
    const uint32_t flags = ~(uint32_t)SBL_MATERIAL_ONE_SIDED_EMISSION;
    return memcmp(a->albedo, b->albedo, sizeof a->albedo) || (a->flags & flags) != (b->flags & flags) ||
           memcmp(&a->alpha_cutoff, &b->alpha_cutoff, sizeof a->alpha_cutoff) ||
           memcmp(a->albedo_texture, b->albedo_texture, sizeof a->albedo_texture);
}

/* Returns the sum of the emitted radiance's three channels, before the texture is applied. */
static double sbl__emission_sum(const sbl__object *o) { return sbl__sum3(o->emission); }

static int sbl__emits(const sbl__object *o, int back) {
    return sbl__max3(o->emission) > 0 && !(back && o->flags & SBL_MATERIAL_ONE_SIDED_EMISSION);
}

/* Returns 1 if SBL__BOUNCE_ALBEDO limits the albedo of the whole surface: it has no albedo texture, and all three
   channels of its albedo exceed the limit. */
static int sbl__holds_light(const sbl__object *o) {
    const float *albedo = o->albedo, most = SBL__BOUNCE_ALBEDO;
    return albedo[0] > most && albedo[1] > most && albedo[2] > most && !o->albedo_texture[1];
}

#define SBL__SHARE_ONE 65535.0f    /* a share of 1, packed into 16 bits */

/* Packs shares of 0 .. 1 into 16 bits each. */
static void sbl__share_pack(const float share[3], uint16_t out[3]) {
    int k;
    for (k = 0; k < 3; k++) out[k] = (uint16_t)(SBL__SHARE_ONE * share[k] + 0.5f);
}

/* Adds SBL__SHARE_ONE * (the radiance that a surface reflects) to sum. share: the surface's albedo, packed by
   sbl__share_pack. light: R at the surface. */
static void sbl__add_reflected(const uint16_t share[3], const float light[3], float sum[3]) {
    int k;
    for (k = 0; k < 3; k++) sum[k] += (float)share[k] * light[k];
}

/* >>glsl material: shaders_embedded/material.glsl, copied by scripts/embed_shaders */
static const char *const sbl__glsl_material[] = {
"// How surfaces emit and reflect light, and where they have holes. No other shader reads a material. >>material in\n",
"// sbl.h does the same on the CPU.\n",
"uniform float epsilon;     // ambient factor: a surface that does not emit has the radiance epsilon * albedo\n",
"uniform bool lamps_apart;  // true: lamps.glsl adds the light of emitters, so sbl_outgoing leaves it out\n",
"\n",
"// A material at a point, with its textures applied.\n",
"struct sbl_Material {\n",
"    vec3 albedo;   // diffuse reflectance\n",
"    bool cut_out;  // the point lies in a hole\n",
"};\n",
"\n",
"sbl_Material sbl_material(int object, sbl_Attributes at) {\n",
"    vec4 texel = sbl_texture(sbl_object_albedo_texture(object), at.uv);\n",
"    vec4 color = at.color * texel * vec4(sbl_object_albedo(object), 1);\n",
"    return sbl_Material(color.rgb, color.a < sbl_object_alpha_cutoff(object));\n",
"}\n",
"\n",
"// False: no point of the object lies in a hole, so sbl_material need not be called to find out.\n",
"bool sbl_has_holes(int object) { return sbl_object_alpha_cutoff(object) > 0.0; }\n",
"\n",
"// True if this is the back of a surface that emits only in front.\n",
"bool sbl_dark_side(int object, bool back) {\n",
"    return back && (sbl_object_flags(object) & SBL_ONE_SIDED_EMISSION) != 0u;\n",
"}\n",
"\n",
"// Radiance that one side of a surface emits, before its texture is applied.\n",
"vec3 sbl_emission(int object, bool back) {\n",
"    return sbl_dark_side(object, back) ? vec3(0) : sbl_object_emission(object);\n",
"}\n",
"\n",
"// True if one side of a surface emits light. Does not call sbl_emission: softpipe would show wrong sides.\n",
"bool sbl_emits(int object, bool back) {\n",
"    vec3 emission = sbl_object_emission(object);\n",
"    return max(max(emission.r, emission.g), emission.b) > 0.0 && !sbl_dark_side(object, back);\n",
"}\n",
"\n",
"// The emission texture at a point, by which sbl_emission must be multiplied.\n",
"vec3 sbl_emission_pattern(int object, sbl_Attributes at) {\n",
"    return sbl_texture(sbl_object_emission_texture(object), at.uv).rgb;\n",
"}\n",
"\n",
"// True if sbl_outgoing does not read `at`.\n",
"bool sbl_outgoing_is_plain(int object, bool back) {\n",
"#if !defined(SBL_TEXTURED)\n",
"    return true;\n",
"#elif defined(SBL_BOUNCED)\n",
"    return false;\n",
"#else\n",
"    return sbl_emits(object, back) ? lamps_apart : epsilon <= 0.0;\n",
"#endif\n",
"}\n",
"\n",
"// Radiance that a surface sends towards a sensor, without the stored light that it reflects: Ck of equations 1 and\n",
"// 2. It is the emission of an emitter; for other surfaces, epsilon times the albedo.\n",
"vec3 sbl_outgoing(int object, bool back, sbl_Attributes at) {\n",
"    bool emits = sbl_emits(object, back);\n",
"    vec3 radiance = emits ? sbl_object_emission(object) : epsilon * sbl_object_albedo(object);\n",
"    if (emits && lamps_apart) radiance = vec3(0);\n",
"    if (!sbl_outgoing_is_plain(object, back)) {\n",
"        uvec4 place = emits ? sbl_object_emission_texture(object) : sbl_object_albedo_texture(object);\n",
"        radiance *= ((emits ? vec4(1) : at.color) * sbl_texture(place, at.uv)).rgb;\n",
"    }\n",
"    return radiance;\n",
"}\n",
"\n",
"// Radiance that a surface reflects. light: R at the surface\n",
"vec3 sbl_reflected(sbl_Material m, vec3 light) { return m.albedo * light; }\n",
"\n",
"// Albedo, as bounces in the store use it: limited below 1, so that light fades even in closed white rooms.\n",
"vec3 sbl_bounced(sbl_Material m) { return clamp(m.albedo, 0.0, SBL_BOUNCE_ALBEDO); }\n",
"\n",
"// A reflected ray.\n",
"struct sbl_Bounce {\n",
"    vec3 direction;\n",
"    vec3 off;     // unit normal, on the side where the ray starts\n",
"    vec3 weight;  // factor of the radiance that the ray finds\n",
"};\n",
"\n",
"// Draws a direction, cosine-distributed, from which a surface reflects light. across: normal of any length; 0 if\n",
"// the triangle has no area, in which case to_receiver replaces it. u: uniform point of the unit square\n",
"sbl_Bounce sbl_bounce(sbl_Material m, vec3 across, vec3 to_receiver, vec2 u) {\n",
"    vec3 normal = dot(across, across) > 0.0 ? normalize(across) : to_receiver;\n",
"    return sbl_Bounce(sbl_by_cosine(sbl_frame(normal), u), normal, m.albedo);\n",
"}\n",
0 };
/* <<glsl */

/* ====================================================================================================== >>environment
   Light from directions without a surface: from the sky, which is constant, and from a picture around the scene. Rays
   over the hemisphere find the picture's radiance up to a limit. Radiance above the limit would make their results
   noisy, so each texel that exceeds the limit is also a lamp, which emits the excess (see >>lamps). */

#define SBL__SKY_LIMIT 4  /* sbl__environment.limit, in multiples of the picture's mean radiance */

typedef struct sbl__environment {
    float sky[3];        /* constant radiance from all directions, added to the picture's */
    float *pixels;       /* radiance of the picture, host's scale included: r g b 0; NULL if there is no picture */
    int width, height;   /* size of the picture, texels */
    float axes[3][3];    /* the picture's x, up and z axes in world space: unit vectors */
    float limit;         /* radiance (largest component) above which a texel is a lamp; 0 if there is no picture */
    float brightest;     /* upper limit of the radiance from any direction: the largest component of the sky
                            plus the largest component of any texel */
    sbl__texture texels; /* the picture on the GPU */
} sbl__environment;

static void sbl__environment_free(const sbl__device *d, sbl__environment *e) {
    sbl__free(d->base, e->pixels);
    sbl__texture_delete(d, &e->texels);
    memset(e, 0, sizeof *e);
}

/* Computes the picture's axes. The shortest rotation that takes +y to the host's `up` is applied to x and z; then both
   are rotated about `up` by desc->rotation. */
static void sbl__environment_axes(sbl__environment *e, const sbl_environment *desc) {
    const double turn = desc->rotation * SBL__PI / 180;
    double up[3] = { 0, 1, 0 }, x[3] = { 1, 0, 0 }, z[3];
    int k;
    for (k = 0; k < 3 && !sbl__all_zero(desc->up, 3); k++) up[k] = desc->up[k];
    sbl__normalize(up);
    if (up[1] > -1 + 1e-9) {  /* if `up` is -y, the rotation is half a turn about the x axis, which keeps x */
        x[0] = 1 - up[0] * up[0] / (1 + up[1]);
        x[1] = -up[0];
        x[2] = -up[0] * up[2] / (1 + up[1]);
    }
    sbl__cross(x, up, z);
    for (k = 0; k < 3; k++) {
        e->axes[0][k] = (float)(cos(turn) * x[k] - sin(turn) * z[k]);
        e->axes[1][k] = (float)up[k];
        e->axes[2][k] = (float)(sin(turn) * x[k] + cos(turn) * z[k]);
    }
}

/* World direction of the centre of a texel. sbl_sky_direction in sky.glsl uses the same mapping. */
static void sbl__environment_direction(const sbl__environment *e, int x, int y, double out[3]) {
    const double angle = SBL__PI * (y + 0.5) / e->height, around = 2 * SBL__PI * ((x + 0.5) / e->width - 0.5);
    int k;
    for (k = 0; k < 3; k++)
        out[k] = sin(angle) * (cos(around) * e->axes[0][k] + sin(around) * e->axes[2][k]) + cos(angle) * e->axes[1][k];
}

/* Computes a texel's linear radiance from the host's pixels or function, times the host's scale. c[3] is 0. */
static void sbl__environment_texel(const sbl__environment *e, const sbl_environment *desc, int x, int y, float c[4]) {
    const sbl_texture *t = &desc->picture;
    double exact[3];
    float direction[3];
    int k;
    memset(c, 0, 4 * sizeof(float));
    if (desc->radiance) {
        sbl__environment_direction(e, x, y, exact);
        for (k = 0; k < 3; k++) direction[k] = (float)exact[k];
        desc->radiance(direction, c, desc->user);
    } else {
        sbl__read_pixel(t, x, y, c);
        for (k = 0; k < 3 && t->format == SBL_PIXELS_SRGB8; k++) c[k] = sbl__srgb_to_linear(c[k]);
    }
    for (k = 0; k < 3; k++) c[k] *= sbl__zero(&desc->scale) ? 1.0f : SBL__MAX(desc->scale, 0.0f);
    c[3] = 0;
}

/* Fills e->pixels; computes e->limit and e->brightest. */
static sbl_result sbl__environment_read(const sbl__base *base, sbl__environment *e, const sbl_environment *desc) {
    double mean = 0, weights = 0;
    float *c = e->pixels;
    int x, y, k;
    for (y = 0; y < e->height; y++) {
        const double weight = sin(SBL__PI * (y + 0.5) / e->height);
        for (x = 0; x < e->width; x++, c += 4) {
            sbl__environment_texel(e, desc, x, y, c);
            for (k = 0; k < 3; k++)
                if (!sbl__between(&c[k], 0, FLT_MAX)) {
                    sbl__log(base, SBL_LOG_ERROR, SBL_LOG_ITEM_INVALID_LIGHT, "environment: component %d of pixel "
                             "%d %d is %g; it must be finite and not negative", k, x, y, (double)c[k]);
                    return SBL_ERROR_INVALID_ARGUMENT;
                }
            mean += weight * sbl__max3(c);
            weights += weight;
            e->brightest = SBL__MAX(e->brightest, sbl__max3(c) + sbl__max3(e->sky));
        }
    }
    e->limit = (float)SBL__MIN(SBL__MAX(SBL__SKY_LIMIT * mean / weights, (double)SBL__SKY_LEAST), FLT_MAX);
    return SBL_SUCCESS;
}

static sbl_result sbl__environment_make(const sbl__device *d, sbl__environment *e, const sbl_scene_desc *desc) {
    const sbl_environment *from = &desc->environment;
    const int most = d->gl.capabilities.max_texture_size;
    sbl_result result;
    memcpy(e->sky, desc->sky, sizeof e->sky);
    e->brightest = sbl__max3(e->sky);
    if (!from->picture.pixels && !from->radiance) return SBL_SUCCESS;
    e->width = from->picture.width ? from->picture.width : 512;
    e->height = from->picture.height ? from->picture.height : 256;
    if (e->width > most || e->height > most) {
        sbl__log(d->base, SBL_LOG_ERROR, SBL_LOG_ITEM_TOO_LARGE, "environment: picture is %d x %d; this driver's "
                 "textures are at most %d across", e->width, e->height, most);
        return SBL_ERROR_UNSUPPORTED;
    }
    sbl__environment_axes(e, from);
    e->pixels = (float *)sbl__alloc_raw(d->base, (size_t)e->width * (size_t)e->height, 16);
    result = e->pixels ? sbl__environment_read(d->base, e, from) : SBL_ERROR_OUT_OF_MEMORY;
    if (result == SBL_SUCCESS) result = sbl__texture_make(d, &e->texels, e->width, e->height, SBL__GL_RGBA32F);
    return result == SBL_SUCCESS ? sbl__texture_write(d, &e->texels, 0, e->height, e->pixels) : result;
}

#define SBL__FAR 1e29f   /* a distance above this means that a ray hit nothing */

/* Radiance that a ray over the hemisphere finds if it hits nothing: the sky's, plus the picture's up to the limit. Same
   as sbl_sky in sky.glsl. */
static void sbl__environment_radiance(const sbl__environment *e, const double direction[3], float light[3]) {
    double d[3] = { 0, 0, 0 }, excess;
    const float *texel;
    int i, k, x, y;
    memcpy(light, e->sky, sizeof e->sky);
    if (!e->pixels) return;
    for (i = 0; i < 3; i++)
        for (k = 0; k < 3; k++) d[i] += direction[k] * (double)e->axes[i][k];
    x = (int)((0.5 + atan2(d[2], d[0]) / (2 * SBL__PI)) * e->width);
    y = (int)(acos(SBL__MIN(SBL__MAX(d[1], -1.0), 1.0)) / SBL__PI * e->height);
    texel = e->pixels + 4 * ((size_t)SBL__MIN(y, e->height - 1) * (size_t)e->width + (size_t)SBL__MIN(x, e->width - 1));
    excess = SBL__MAX(1 - (double)(e->limit / SBL__MAX(sbl__max3(texel), SBL__SKY_LEAST)), 0);
    for (k = 0; k < 3; k++) light[k] += (float)((1 - excess) * (double)texel[k]);
}

/* Sets the uniforms of sky.glsl. */
static void sbl__environment_bind(sbl__device *d, const sbl__environment *e) {
    sbl__bind(d, "sky_picture", &e->texels);
    sbl__set_vec3(d, "sky_x", e->axes[0]);
    sbl__set_vec3(d, "sky_up", e->axes[1]);
    sbl__set_vec3(d, "sky_z", e->axes[2]);
    sbl__set_float(d, "sky_limit", e->limit);
    sbl__set_vec3(d, "sky", e->sky);
}

/* >>glsl sky: shaders_embedded/sky.glsl, copied by scripts/embed_shaders */
static const char *const sbl__glsl_sky[] = {
"// The environment (see sbl_environment). Its picture is in equirectangular projection.\n",
"uniform sampler2D sky_picture;\n",
"uniform vec3 sky;                   // constant radiance from all directions, added to the picture's\n",
"uniform vec3 sky_x, sky_up, sky_z;  // axes of the picture in world space: unit vectors\n",
"uniform float sky_limit;            // radiance (largest component) above which a texel is also a lamp, which emits\n",
"                                    // the excess; 0: no picture\n",
"\n",
"// Position in the picture where a direction points to: 0 to 1 from left to right and from top to bottom.\n",
"vec2 sbl_sky_at(vec3 direction) {\n",
"    vec3 d = vec3(dot(direction, sky_x), dot(direction, sky_up), dot(direction, sky_z)) / length(direction);\n",
"    float around = d.x == 0.0 && d.z == 0.0 ? 0.0 : atan(d.z, d.x) / (2.0 * SBL_PI);\n",
"    return vec2(0.5 + around, acos(clamp(d.y, -1.0, 1.0)) / SBL_PI);\n",
"}\n",
"\n",
"// Inverse of sbl_sky_at: world direction of a position in the picture. across: 0 to 1 from left to right;\n",
"// z: cosine of the angle between the direction and sky_up\n",
"vec3 sbl_sky_direction(float across, float z) {\n",
"    float angle = 2.0 * SBL_PI * (across - 0.5), r = sqrt(max(1.0 - z * z, 0.0));\n",
"    return r * cos(angle) * sky_x + z * sky_up + r * sin(angle) * sky_z;\n",
"}\n",
"\n",
"// Share of a texel's light, 0 to 1, that lamps.glsl samples because it exceeds the limit.\n",
"float sbl_sky_excess(vec3 radiance) {\n",
"    return max(1.0 - sky_limit / max(max(radiance.r, radiance.g), max(radiance.b, SBL_SKY_LEAST)), 0.0);\n",
"}\n",
"\n",
"// Radiance that a ray finds if it hits nothing, without the share that lamps.glsl samples.\n",
"vec3 sbl_sky(vec3 direction) {\n",
"    vec3 radiance = vec3(0);\n",
"    if (sky_limit > 0.0) {\n",
"        ivec2 size = textureSize(sky_picture, 0);\n",
"        radiance = texelFetch(sky_picture, min(ivec2(sbl_sky_at(direction) * vec2(size)), size - 1), 0).rgb;\n",
"        radiance *= 1.0 - sbl_sky_excess(radiance);\n",
"    }\n",
"    return sky + radiance;\n",
"}\n",
0 };
/* <<glsl */

/* ======================================================================================================== >>bvh
   The bounding volume hierarchy over the scene's triangles, built with the binned surface-area heuristic (Wald 2007,
   "On fast Construction of SAH-based Bounding Volume Hierarchies"). A node takes two texels, one for each child. Boxes
   are stored in 16-bit steps of a grid over the scene, or of a finer grid around small geometry. The hierarchy is built
   in slices, when it is first needed and again after surfaces have changed. */

#define SBL__BVH_BINS 16         /* bins per axis */
#define SBL__BVH_LEAF 4          /* maximum number of triangles in a leaf; the format allows 8 */
#define SBL__BVH_SAH_DEPTH 32    /* nodes from this depth on get halves of equal triangle counts, to limit the depth */
#define SBL__BVH_DROPPED 0xffffffffu  /* marks an unused element of sbl__hierarchy.order */
#define SBL__BVH_GRID_STEPS 512  /* upper limit of all sides of a box with its own grid, steps of its parent's grid */
#define SBL__BVH_GRID_LEAST 32   /* minimum number of triangles of a node that gets its own grid */
#define SBL__BVH_CHUNK 32        /* triangles per turn of a loop, so that the overhead of turns is negligible */
#define SBL__UPLOAD_CHUNK 65536  /* bytes per piece of an upload */

/* x, y, z of a child: lowest | highest << 16 coordinate of its box, in grid steps. w: number of a node, or
   SBL_LEAF | triangles - 1 << 28 | first triangle, or SBL_ENTER | number of a grid record. */
#define SBL__NODE(X) X(sbl__node, UVEC4, child_0) X(sbl__node, UVEC4, child_1)
SBL__RECORD(sbl__node, SBL__NODE, "sbl_node", "sbl_nodes", SBL__SCENE_TABLE("sbl_nodes"), NULL)

/* A grid, which is stored in the place of a node. root: number of its first node. around: number of the outer grid */
#define SBL__GRID_NODE(X) \
    X(sbl__grid_node, VEC3, origin) X(sbl__grid_node, UINT, root) \
    X(sbl__grid_node, VEC3, per_length) X(sbl__grid_node, UINT, around)
SBL__RECORD(sbl__grid_node, SBL__GRID_NODE, "sbl_grid", "sbl_nodes", "", NULL)

/* Triangles in the order of the leaves. number: the triangle's number in the scene. cutout: 1 if it may have holes */
#define SBL__TRIANGLE(X) \
    X(sbl__triangle, VEC3, corner_0) X(sbl__triangle, UINT, object) \
    X(sbl__triangle, VEC3, corner_1) X(sbl__triangle, UINT, number) \
    X(sbl__triangle, VEC3, corner_2) X(sbl__triangle, UINT, cutout)
SBL__RECORD(sbl__triangle, SBL__TRIANGLE, "sbl_triangle", "sbl_triangles", SBL__SCENE_TABLE("sbl_triangles"), NULL)

typedef struct sbl__box { float low[3], high[3]; } sbl__box;

static const sbl__box sbl__box_empty = { { FLT_MAX, FLT_MAX, FLT_MAX }, { -FLT_MAX, -FLT_MAX, -FLT_MAX } };

/* Extends a box so that it contains all coordinates from low to high. */
static void sbl__box_grow(sbl__box *b, const float *low, const float *high) {
    int k;
    for (k = 0; k < 3; k++) {
        b->low[k] = SBL__MIN(b->low[k], low[k]);
        b->high[k] = SBL__MAX(b->high[k], high[k]);
    }
}

static void sbl__box_add_point(sbl__box *b, const float *p) { sbl__box_grow(b, p, p); }
static void sbl__box_add(sbl__box *b, const sbl__box *other) { sbl__box_grow(b, other->low, other->high); }

static void sbl__box_of_triangle(sbl__box *b, const sbl__geometry *g, uint32_t triangle) {
    int k;
    *b = sbl__box_empty;
    for (k = 0; k < 3; k++) sbl__box_add_point(b, sbl__triangle_corner(g, triangle, k));
}

/* Returns half the surface area of a box; 0 if it is empty. */
static float sbl__box_area(const sbl__box *b) {
    float x = b->high[0] - b->low[0], y = b->high[1] - b->low[1], z = b->high[2] - b->low[2];
    return x < 0 ? 0 : x * y + y * z + z * x;
}

/* Bounds of triangles, and of their centroids multiplied by 2 */
typedef struct sbl__bvh_bounds { sbl__box box, centroids; } sbl__bvh_bounds;

/* A node to build, over triangles first .. first + count - 1 of the order. child: number of the element of
   sbl__bvh.children whose last word receives the node's number */
typedef struct sbl__bvh_task {
    int first, count, depth, child;
    sbl__grid_node grid;
    sbl__bvh_bounds bounds;
} sbl__bvh_task;

/* The split of a task's triangles into two parts, one for each child. */
typedef struct sbl__bvh_split {
    int left;                    /* triangles moved to the first part so far */
    int axis, bin;               /* the first part ends with this bin along the axis; axis < 0: there is no split */
    float scale[3];              /* bins per unit of doubled centroids; 0: the axis is not split */
    sbl__box bins[3][SBL__BVH_BINS];
    int counts[3][SBL__BVH_BINS];
    sbl__bvh_bounds parts[2];
} sbl__bvh_split;

/* Cost of a node. sum: area of its box * number of nodes and triangles that a ray through the box tests on average */
typedef struct sbl__bvh_work { double sum; float area; int parent; } sbl__bvh_work;

enum { SBL__BVH_BOXES, SBL__BVH_COUNT, SBL__BVH_PART, SBL__BVH_NODE, SBL__BVH_COSTS };

typedef struct sbl__bvh {        /* data for building the hierarchy */
    sbl__stages stages;
    const sbl__device *device;
    const sbl__geometry *geometry;
    struct sbl__hierarchy *hierarchy;
    uint32_t (*children)[4];     /* sbl__node: 2 * n and 2 * n + 1 are the children of node n */
    sbl__box *boxes;             /* bounds of each triangle */
    sbl__bvh_work *work;         /* cost of each node */
    sbl__bvh_task stack[2 * SBL__STACK];  /* tasks to do; the first is for all triangles */
    sbl__bvh_task task;          /* the current task */
    int top;                     /* number of tasks on the stack */
    sbl__bvh_split split;
    sbl__triangle records[SBL__UPLOAD_CHUNK / sizeof(sbl__triangle)];  /* a piece of an upload */
} sbl__bvh;

typedef struct sbl__hierarchy {
    int ready;
    int node_count, triangle_count;
    sbl__grid_node grid;         /* the grid over the scene */
    double cost;                 /* highest sum / area of any node, see sbl__bvh_work */
    double seconds;              /* time spent on building */
    sbl__table node_table, triangle_table;
    uint32_t *order;             /* triangle numbers, leaf after leaf; read by >>lamps */
    sbl__bvh *building;          /* NULL if the hierarchy is not being built */
} sbl__hierarchy;

static void sbl__bvh_free(const sbl__device *d, sbl__bvh *b) {
    if (!b) return;
    sbl__free(d->base, b->children);
    sbl__free(d->base, b->boxes);
    sbl__free(d->base, b->work);
    sbl__free(d->base, b);
}

static void sbl__hierarchy_free(const sbl__device *d, sbl__hierarchy *h) {
    sbl__bvh_free(d, h->building);
    sbl__free(d->base, h->order);
    sbl__table_delete(d, &h->node_table);
    sbl__table_delete(d, &h->triangle_table);
    memset(h, 0, sizeof *h);
}

/* >>bvh: splitting */

static void sbl__bvh_bounds_add(sbl__bvh_bounds *bounds, const sbl__box *box) {
    float centroid[3];
    int k;
    for (k = 0; k < 3; k++) centroid[k] = box->low[k] + box->high[k];
    sbl__box_add(&bounds->box, box);
    sbl__box_add_point(&bounds->centroids, centroid);
}

/* Returns the bin of a triangle's box along an axis. */
static int sbl__bvh_bin(const sbl__bvh *b, const sbl__box *box, int axis) {
    return (int)((box->low[axis] + box->high[axis] - b->task.bounds.centroids.low[axis]) * b->split.scale[axis]);
}

static int sbl__bvh_chunks(void *work) {
    return (((sbl__bvh *)work)->task.count + SBL__BVH_CHUNK - 1) / SBL__BVH_CHUNK;
}

/* Puts the triangles of a chunk into bins (SBL__BVH_COUNT), or moves those of the first part to the front of the task
   (SBL__BVH_PART). */
static sbl_result sbl__bvh_chunk(void *work, int chunk) {
    sbl__bvh *b = (sbl__bvh *)work;
    sbl__bvh_split *s = &b->split;
    uint32_t *order = b->hierarchy->order;
    const int first = b->task.first + chunk * SBL__BVH_CHUNK;
    const int end = SBL__MIN(first + SBL__BVH_CHUNK, b->task.first + b->task.count);
    int i, axis;
    for (i = first; i < end; i++) {
        const uint32_t number = order[i];
        const sbl__box *box = &b->boxes[number];
        if (b->stages.stage == SBL__BVH_PART) {
            const int second = sbl__bvh_bin(b, box, s->axis) > s->bin;
            sbl__bvh_bounds_add(&s->parts[second], box);
            if (second) continue;
            order[i] = order[b->task.first + s->left];
            order[b->task.first + s->left++] = number;
        } else for (axis = 0; axis < 3; axis++) {
            const int bin = s->scale[axis] > 0 ? sbl__bvh_bin(b, box, axis) : 0;
            sbl__box_add(&s->bins[axis][bin], box);
            s->counts[axis][bin]++;
        }
    }
    return SBL_SUCCESS;
}

/* Chooses the split between two bins that costs least by the surface-area heuristic. */
static int sbl__bvh_choose(void *work) {
    sbl__bvh *b = (sbl__bvh *)work;
    sbl__bvh_split *s = &b->split;
    float best = FLT_MAX, areas[SBL__BVH_BINS], cost;
    int axis, k, n;
    for (axis = 0; axis < 3; axis++) {
        sbl__box sweep = sbl__box_empty;
        if (s->scale[axis] <= 0) continue;
        for (k = SBL__BVH_BINS - 1, n = 0; k > 0; k--) {
            sbl__box_add(&sweep, &s->bins[axis][k]);
            n += s->counts[axis][k];
            areas[k] = n ? sbl__box_area(&sweep) * (float)n : 0;
        }
        sweep = sbl__box_empty;
        for (k = 0, n = 0; k < SBL__BVH_BINS - 1; k++) {
            sbl__box_add(&sweep, &s->bins[axis][k]);
            n += s->counts[axis][k];
            if (n == 0 || n == b->task.count) continue;
            cost = sbl__box_area(&sweep) * (float)n + areas[k + 1];
            if (cost < best) { best = cost; s->axis = axis; s->bin = k; }
        }
    }
    return s->axis >= 0 ? SBL__BVH_PART : SBL__BVH_NODE;
}

/* >>bvh: nodes */

/* Converts a box to steps of a grid, rounding outwards. It grows by at least 0.02 steps on each side. */
static void sbl__bvh_quantise(const sbl__grid_node *grid, const sbl__box *b, uint32_t out[3]) {
    int k;
    for (k = 0; k < 3; k++) {
        double low = floor(((double)b->low[k] - grid->origin[k]) * grid->per_length[k] - 0.02);
        double high = ceil(((double)b->high[k] - grid->origin[k]) * grid->per_length[k] + 0.02);
        out[k] = (uint32_t)SBL__MIN(SBL__MAX(low, 0), 65535) | (uint32_t)SBL__MIN(SBL__MAX(high, 0), 65535) << 16;
    }
}

/* Appends a grid over a box, with a margin of one step on each side, in the place of the next node. */
static sbl__grid_node sbl__bvh_add_grid(sbl__hierarchy *h, const sbl__box *b, uint32_t around) {
    const float longest = SBL__MAX(b->high[0] - b->low[0], SBL__MAX(b->high[1] - b->low[1], b->high[2] - b->low[2]));
    const int place = h->node_count++;
    sbl__grid_node grid;
    int k;
    for (k = 0; k < 3; k++) {  /* steps must not be finer than the resolution of floats */
        double size = SBL__MAX(1e-4 * (double)longest, SBL__MAX(1e-6 * fabs((double)b->low[k]), 1e-30));
        size = SBL__MAX((double)b->high[k] - b->low[k], size);
        grid.per_length[k] = (float)(65533 / size);
        grid.origin[k] = (float)(b->low[k] - size / 65533);
    }
    grid.root = (uint32_t)place + 1;
    grid.around = around;
    memcpy(&h->building->children[2 * place], &grid, sizeof grid);
    return grid;
}

/* Compares triangles: the bits of nine coordinates, then the number. */
static int sbl__bvh_corner_order(const void *first, const void *second) {
    const uint32_t *a = (const uint32_t *)first, *b = (const uint32_t *)second;
    int k = 0;
    while (k < 9 && a[k] == b[k]) k++;
    return a[k] < b[k] ? -1 : a[k] > b[k];
}

/* Drops triangles with exactly the corners of another triangle that has a lower number and no holes. No ray hits such
   copies, but rays would test them. Shortens the task. */
static sbl_result sbl__bvh_drop_copies(const sbl__bvh *b, sbl__bvh_task *t) {
    const sbl__geometry *g = b->geometry;
    uint32_t *order = b->hierarchy->order;
    uint32_t (*corners)[10] = (uint32_t (*)[10])sbl__alloc(b->device->base, (size_t)t->count, sizeof *corners);
    int i, k, kept = 0, last = 0;
    if (!corners) return SBL_ERROR_OUT_OF_MEMORY;
    for (i = 0; i < t->count; i++) {
        const uint32_t number = order[t->first + i];
        for (k = 0; k < 3; k++) memcpy(corners[i] + 3 * k, sbl__triangle_corner(g, number, k), 12);
        corners[i][9] = number;
    }
    qsort(corners, (size_t)t->count, sizeof *corners, sbl__bvh_corner_order);
    for (i = 0; i < t->count; i++) {
        if (i && !memcmp(corners[i], corners[last], 36) &&
            sbl__triangle_object(g, corners[last][9])->alpha_cutoff == 0.0f)
            continue;
        last = i;
        order[t->first + kept++] = corners[i][9];
    }
    for (i = kept; i < t->count; i++) order[t->first + i] = SBL__BVH_DROPPED;
    t->count = kept;
    sbl__free(b->device->base, corners);
    return SBL_SUCCESS;
}

/* Begins the top task of the stack: makes the next node a child of its parent, inserts a finer grid between them if the
   node's box is small in the parent's grid, and empties the bins. */
static int sbl__bvh_next_task(void *work) {
    sbl__bvh *b = (sbl__bvh *)work;
    sbl__hierarchy *h = b->hierarchy;
    sbl__bvh_split *s = &b->split;
    sbl__bvh_task *t = &b->task;
    const sbl__box *box = &t->bounds.box, *centroids = &t->bounds.centroids;
    uint32_t *child;
    int axis, k, fine = 1;
    if (!b->top) return SBL__BVH_COSTS;
    *t = b->stack[--b->top];
    child = &b->children[t->child][3];
    *child = (uint32_t)h->node_count;
    for (k = 0; k < 3; k++) fine &= (box->high[k] - box->low[k]) * t->grid.per_length[k] < SBL__BVH_GRID_STEPS;
    if (fine && t->count >= SBL__BVH_GRID_LEAST && t->depth < SBL__BVH_SAH_DEPTH) {
        t->depth++;
        *child |= SBL__ENTER;
        t->grid = sbl__bvh_add_grid(h, box, t->grid.root - 1);
    }
    memset(s, 0, sizeof *s);
    s->axis = -1;
    for (k = 0; k < 2; k++) s->parts[k].box = s->parts[k].centroids = sbl__box_empty;
    for (axis = 0; axis < 3; axis++) {
        const float size = centroids->high[axis] - centroids->low[axis];
        const float scale = size > 0 ? (float)SBL__BVH_BINS * 0.99999f / size : 0;
        if (sbl__finite(&scale) && t->depth < SBL__BVH_SAH_DEPTH) s->scale[axis] = scale;
        for (k = 0; k < SBL__BVH_BINS; k++) s->bins[axis][k] = sbl__box_empty;
    }
    return SBL__BVH_COUNT;
}

/* Writes the node of the present task after its split. Each part becomes a leaf or a task. */
static sbl_result sbl__bvh_end_task(void *work, sbl__slice *slice) {
    sbl__bvh *b = (sbl__bvh *)work;
    sbl__bvh_split *s = &b->split;
    sbl__bvh_task *t = &b->task;
    const int node = b->hierarchy->node_count++;
    int side, i;
    (void)slice;
    if (!s->left) {  /* no split was found: halves. The first half of one triangle is empty; no ray enters its box */
        const sbl_result result = sbl__bvh_drop_copies(b, t);
        if (result != SBL_SUCCESS) return result;
        s->left = t->count / 2;
        for (i = 0; i < t->count; i++)
            sbl__bvh_bounds_add(&s->parts[i >= s->left], &b->boxes[b->hierarchy->order[t->first + i]]);
    }
    b->work[node].area = sbl__box_area(&t->bounds.box);
    b->work[node].parent = t->child / 2;
    for (side = 0; side < 2; side++) {
        const int first = side ? t->first + s->left : t->first, count = side ? t->count - s->left : s->left;
        uint32_t *child = b->children[2 * node + side];
        sbl__bvh_quantise(&t->grid, &s->parts[side].box, child);
        b->work[node].sum += (double)sbl__box_area(&s->parts[side].box) * (count <= SBL__BVH_LEAF ? 1 + count : 1);
        if (count <= SBL__BVH_LEAF)
            child[3] = SBL__LEAF | (uint32_t)(SBL__MAX(1, count) - 1) << 28 | (uint32_t)first;
        else {
            sbl__bvh_task *task = &b->stack[b->top++];
            *task = *t;
            task->first = first;
            task->count = count;
            task->depth++;
            task->child = 2 * node + side;
            task->bounds = s->parts[side];
        }
    }
    return SBL_SUCCESS;
}

/* >>bvh: stages */

static sbl_result sbl__bvh_begin(const sbl__device *d, const sbl__geometry *g, sbl__hierarchy *h) {
    const size_t room = (size_t)SBL__MAX(1, g->triangle_count), nodes = room + room / SBL__BVH_GRID_LEAST + 2;
    sbl__bvh *b = (sbl__bvh *)sbl__alloc(d->base, 1, sizeof *b);
    if (!b) return SBL_ERROR_OUT_OF_MEMORY;
    h->building = b;
    b->device = d;
    b->geometry = g;
    b->hierarchy = h;
    h->node_count = h->triangle_count = 0;
    h->cost = h->seconds = 0;
    b->children = (uint32_t (*)[4])sbl__alloc_raw(d->base, nodes, sizeof(sbl__node));
    sbl__free(d->base, h->order);
    h->order = (uint32_t *)sbl__alloc_raw(d->base, room, 4);
    b->boxes = (sbl__box *)sbl__alloc_raw(d->base, room, sizeof *b->boxes);
    b->work = (sbl__bvh_work *)sbl__alloc(d->base, nodes, sizeof *b->work);
    b->stack[0].bounds.box = b->stack[0].bounds.centroids = sbl__box_empty;
    return b->children && h->order && b->boxes && b->work ? SBL_SUCCESS : SBL_ERROR_OUT_OF_MEMORY;
}

static int sbl__bvh_all_triangles(void *work) { return ((sbl__bvh *)work)->geometry->triangle_count; }

/* Adds a triangle, unless it is hidden from sensors. */
static sbl_result sbl__bvh_box(void *work, int at) {
    sbl__bvh *b = (sbl__bvh *)work;
    const uint32_t i = (uint32_t)at;
    if (sbl__triangle_object(b->geometry, i)->flags & SBL_MATERIAL_HIDDEN_FROM_SENSORS) return SBL_SUCCESS;
    b->hierarchy->order[b->hierarchy->triangle_count++] = i;
    sbl__box_of_triangle(&b->boxes[i], b->geometry, i);
    sbl__bvh_bounds_add(&b->stack[0].bounds, &b->boxes[i]);
    return SBL_SUCCESS;
}

/* Begins a task for all triangles, if there are any. */
static int sbl__bvh_after_boxes(void *work) {
    sbl__bvh *b = (sbl__bvh *)work;
    sbl__hierarchy *h = b->hierarchy;
    sbl__bvh_task *task = &b->stack[0];
    if (h->triangle_count) {
        b->top = 1;
        task->count = h->triangle_count;
        /* The grid takes the place of node 0, so children[0][3], where this task with child 0 writes the number of its
           node, is the grid's field `root`. */
        h->grid = task->grid = sbl__bvh_add_grid(h, &task->bounds.box, 0);
    }
    return sbl__bvh_next_task(b);
}

static int sbl__bvh_inner_nodes(void *work) { return ((sbl__bvh *)work)->hierarchy->node_count - 1; }

/* Adds a node's cost to its parent's. Nodes are visited from last to first, since children follow their parents. */
static sbl_result sbl__bvh_cost(void *work, int at) {
    sbl__bvh *b = (sbl__bvh *)work;
    sbl__hierarchy *h = b->hierarchy;
    const sbl__bvh_work *node = &b->work[h->node_count - 1 - at];
    b->work[node->parent].sum += node->sum;
    if (node->area > 0) h->cost = SBL__MAX(h->cost, node->sum / node->area);
    return SBL_SUCCESS;
}

/* Uploads the next piece of a table of `all` elements of `size` bytes. from: elements stages.at and following. Advances
   stages.at. Attaches the table after the last piece. */
static sbl_result sbl__bvh_upload(sbl__bvh *b, sbl__table *t, const void *from, size_t size, int all) {
    int *at = &b->stages.at;
    const int count = SBL__MIN(SBL__UPLOAD_CHUNK / (int)size, all - *at);
    sbl_result result = SBL_SUCCESS;
    if (!*at) result = sbl__buffer_make(b->device, &t->buffer, size * (size_t)all, NULL, SBL__GL_STATIC_DRAW);
    if (result != SBL_SUCCESS) return result;
    if (count) sbl__buffer_write(b->device, &t->buffer, size * (size_t)*at, size * (size_t)count, from);
    *at += count;
    if (*at < all) return SBL_UNFINISHED;
    result = sbl__table_attach(b->device, t, SBL__GL_RGBA32UI, b->geometry->wide);
    if (b->geometry->wide) sbl__buffer_delete(b->device, &t->buffer);  /* the 2D texture holds a copy */
    return result;
}

/* Uploads a piece of the triangles' records, in the order of the leaves. */
static sbl_result sbl__bvh_triangles(void *work, sbl__slice *slice) {
    sbl__bvh *b = (sbl__bvh *)work;
    const sbl__geometry *g = b->geometry;
    sbl__hierarchy *h = b->hierarchy;
    const int count = SBL__MIN(SBL__COUNT(b->records), h->triangle_count - b->stages.at);
    int i;
    (void)slice;
    for (i = 0; i < count; i++) {
        const uint32_t number = h->order[b->stages.at + i];
        sbl__triangle *t = &b->records[i];
        if (number == SBL__BVH_DROPPED) continue;
        memcpy(t->corner_0, sbl__triangle_corner(g, number, 0), 12);
        memcpy(t->corner_1, sbl__triangle_corner(g, number, 1), 12);
        memcpy(t->corner_2, sbl__triangle_corner(g, number, 2), 12);
        t->object = g->vertices[g->indices[3 * (size_t)number]].object;
        t->number = number;
        t->cutout = sbl__triangle_object(g, number)->alpha_cutoff != 0.0f;
    }
    return sbl__bvh_upload(b, &h->triangle_table, b->records, sizeof *b->records, h->triangle_count);
}

static sbl_result sbl__bvh_nodes(void *work, sbl__slice *slice) {
    sbl__bvh *b = (sbl__bvh *)work;
    sbl__hierarchy *h = b->hierarchy;
    (void)slice;
    return sbl__bvh_upload(b, &h->node_table, b->children + 2 * b->stages.at, sizeof(sbl__node), h->node_count);
}

/* Builds the hierarchy and uploads it. SBL_SUCCESS: it is ready. After an error the caller may begin again. */
static sbl_result sbl__hierarchy_step(sbl__device *d, const sbl__geometry *g, sbl__hierarchy *h, sbl__slice *slice) {
    static const sbl__stage_row table[] = {
        { NULL, sbl__bvh_after_boxes, sbl__bvh_box, sbl__bvh_all_triangles },
        { NULL, sbl__bvh_choose, sbl__bvh_chunk, sbl__bvh_chunks },
        { NULL, NULL, sbl__bvh_chunk, sbl__bvh_chunks },
        { sbl__bvh_end_task, sbl__bvh_next_task, NULL, NULL },
        { NULL, NULL, sbl__bvh_cost, sbl__bvh_inner_nodes },
        { sbl__bvh_triangles, NULL, NULL, NULL },
        { sbl__bvh_nodes, NULL, NULL, NULL }
    };
    const double start = sbl__now();
    sbl_result result = SBL_SUCCESS;
    if (h->ready) return SBL_SUCCESS;
    d->gl.doing = "storing the hierarchy";
    if (!h->building) result = sbl__bvh_begin(d, g, h);
    if (result == SBL_SUCCESS) result = sbl__stages_run(&h->building->stages, table, SBL__COUNT(table), h->building,
                                                        slice);
    h->seconds += sbl__now() - start;
    if (result == SBL_UNFINISHED) return result;
    h->ready = result == SBL_SUCCESS;
    sbl__bvh_free(d, h->building);
    h->building = NULL;
    return result;
}

/* Sets the tables and uniforms of traverse.glsl. */
static void sbl__hierarchy_bind(sbl__device *d, const sbl__hierarchy *h) {
    sbl__bind_table(d, "sbl_nodes", &h->node_table);
    sbl__bind_table(d, "sbl_triangles", &h->triangle_table);
    sbl__set_vec3(d, "grid_origin", h->grid.origin);
    sbl__set_vec3(d, "grid_per_length", h->grid.per_length);
    sbl__set_int(d, "node_count", h->node_count);
}

/* >>glsl traverse: shaders_embedded/traverse.glsl, copied by scripts/embed_shaders */
static const char *const sbl__glsl_traverse[] = {
"// Traces rays through the bounding volume hierarchy (see >>bvh in sbl.h).\n",
"uniform vec3 grid_origin;      // origin of the grid over the scene, as in grid record number 0\n",
"uniform vec3 grid_per_length;  // steps of that grid per unit of length\n",
"uniform int node_count;        // 0: the scene is empty\n",
"\n",
"const int SBL_HOLES = 64;            // a ray that meets this many holes of cut-out surfaces ends at the last one\n",
"const int SBL_BOX_SLACK = 8;         // added to the distance at which a ray leaves a box, units in the last place\n",
"                                     // (Ize 2013, \"Robust BVH Ray Traversal\")\n",
"const float SBL_SELF_DEEP = 1e-4;    // hits nearer than this * deep must be farther than the rounding error\n",
"const float SBL_SELF_WIDE = 2.4e-7;  // the rounding error is this * deep * wide / abs(determinant), see sbl_test\n",
"\n",
"// Attributes at barycentrics b1, b2 of a triangle of sbl_triangles.\n",
"sbl_Attributes sbl_attributes_at(int triangle, float b1, float b2) {\n",
"#ifdef SBL_TEXTURED\n",
"    ivec3 corners = sbl_corners(int(sbl_triangle_number(triangle)));\n",
"    vec3 b = vec3(1.0 - b1 - b2, b1, b2);\n",
"    sbl_Attributes at = sbl_Attributes(vec2(0), vec4(0));\n",
"    for (int k = 0; k < 3; k++) {\n",
"        int v = corners[k];\n",
"        at.uv += b[k] * vec2(sbl_attributes_u(v), sbl_attributes_v(v));\n",
"        vec4 color = sbl_unpack_color(sbl_attributes_color_rg(v), sbl_attributes_color_ba(v));\n",
"        at.color += b[k] / SBL_COLOR_MOST * color;\n",
"    }\n",
"    return at;\n",
"#else\n",
"    return SBL_PLAIN;\n",
"#endif\n",
"}\n",
"\n",
"struct sbl_Hit {\n",
"    float distance;   // in units of the direction's length\n",
"    int triangle;     // number in sbl_triangles; negative: nothing was hit\n",
"    int number;       // the triangle's number in the scene\n",
"    float b1, b2;     // barycentrics of the second and third corner\n",
"    bool back;\n",
"};\n",
"\n",
"sbl_Attributes sbl_attributes_of(sbl_Hit hit) { return sbl_attributes_at(hit.triangle, hit.b1, hit.b2); }\n",
"\n",
"// Returns the distance at which the ray enters the box; 0x7fffffff if it does not enter before `nearest`.\n",
"// Distances are the bits of floats: as integers, those of positive floats have the same order, and those of\n",
"// negative floats are negative. per: ray distance per grid step. offset: ray distance of the grid's origin. flip:\n",
"// where the ray's direction is negative\n",
"int sbl_box(uvec4 box, vec3 per, vec3 offset, bvec3 flip, int nearest) {\n",
"    vec3 low = vec3(box.xyz & 65535u), high = vec3(box.xyz >> 16);\n",
"    ivec3 entry = floatBitsToInt(mix(low, high, flip) * per + offset);\n",
"    ivec3 leave = floatBitsToInt(mix(high, low, flip) * per + offset);\n",
"    int from = max(max(entry.x, entry.y), max(entry.z, 0)), to = min(min(leave.x, leave.y), min(leave.z, nearest));\n",
"    return from <= to + SBL_BOX_SLACK ? from : 0x7fffffff;\n",
"}\n",
"\n",
"// A ray for triangle tests, which are watertight at shared edges (Woop, Benthin and Wald 2013). The axis of the\n",
"// direction's largest component becomes z, and space is sheared so that the ray follows z.\n",
"struct sbl_Ray {\n",
"    vec3 origin;\n",
"    int axis;\n",
"    vec2 shear;\n",
"    float z, per_z;  // the direction's component along the axis, and its reciprocal\n",
"    float after;     // hits at a lower distance are ignored\n",
"    int past;        // hits at the distance `after` are ignored if the triangle's number is at most this\n",
"};\n",
"\n",
"vec3 sbl_turn(vec3 v, int axis) { return axis == 0 ? v.yzx : axis == 1 ? v.zxy : v; }\n",
"\n",
"// Four times the signed area of the triangle of an edge and the ray. The two equal terms make the result for (b,\n",
"// a) the exact opposite, even if the driver rounds only one product of each a * b - c * d.\n",
"float sbl_side(vec2 a, vec2 b) { return (a.x * b.y - a.y * b.x) - (b.x * a.y - b.y * a.x); }\n",
"\n",
"void sbl_test(int triangle, sbl_Ray ray, inout sbl_Hit hit) {\n",
"    vec3 p = sbl_turn(sbl_triangle_corner_0(triangle) - ray.origin, ray.axis);\n",
"    vec3 q = sbl_turn(sbl_triangle_corner_1(triangle) - ray.origin, ray.axis);\n",
"    vec3 r = sbl_turn(sbl_triangle_corner_2(triangle) - ray.origin, ray.axis);\n",
"    int number = int(sbl_triangle_number(triangle));\n",
"    p.xy -= ray.shear * p.z;\n",
"    q.xy -= ray.shear * q.z;\n",
"    r.xy -= ray.shear * r.z;\n",
"    float u = sbl_side(r.xy, q.xy), v = sbl_side(p.xy, r.xy), w = sbl_side(q.xy, p.xy), determinant = u + v + w;\n",
"    bool front = u >= 0.0 && v >= 0.0 && w >= 0.0, back = u <= 0.0 && v <= 0.0 && w <= 0.0;\n",
"    bool inside = (front || back) && determinant != 0.0;\n",
"    float l = (u * p.z + v * q.z + w * r.z) * ray.per_z / determinant;\n",
"    // Rounding must not cause a hit of a triangle close to the ray's origin, such as the one that it starts on. A\n",
"    // hit nearer than SBL_SELF_DEEP * deep counts only if its distance is larger than the rounding error,\n",
"    // which is larger for thin triangles.\n",
"    float deep = max(abs(p.z), max(abs(q.z), abs(r.z)));\n",
"    float wide = max(dot(p.xy, p.xy), max(dot(q.xy, q.xy), dot(r.xy, r.xy)));\n",
"    inside = inside && l > SBL_SELF_DEEP * deep || inside && l * abs(determinant) > SBL_SELF_WIDE * deep * wide;\n",
"    bool behind = l > ray.after || (l == ray.after && number > ray.past);\n",
"    if (inside && behind && (l < hit.distance || (l == hit.distance && number < hit.number)))\n",
"        hit = sbl_Hit(l, triangle, number, v / determinant, w / determinant, (determinant < 0.0) == (ray.z > 0.0));\n",
"}\n",
"\n",
"// Returns the nearest hit below the distance `limit` and above `after`, or at `after` with a number above `past`.\n",
"sbl_Hit sbl_nearest(vec3 origin, vec3 direction, float after, int past, float limit) {\n",
"    sbl_Hit hit = sbl_Hit(limit, -1, -1, 0.0, 0.0, false);\n",
"    vec3 size = abs(direction);\n",
"    int axis = size.x > size.y ? (size.x > size.z ? 0 : 2) : (size.y > size.z ? 1 : 2);\n",
"    vec3 d = sbl_turn(direction, axis);\n",
"    sbl_Ray ray = sbl_Ray(origin, axis, d.xy / d.z, d.z, 1.0 / d.z, after, past);\n",
"\n",
"    bvec3 flip = lessThan(direction, vec3(0));\n",
"    vec3 inverse = 1.0 / mix(max(direction, vec3(1e-12)), min(direction, vec3(-1e-12)), flip);\n",
"    vec3 per = inverse / grid_per_length, offset = (grid_origin - origin) * inverse;\n",
"    uint stack[SBL_STACK];\n",
"    stack[0] = SBL_END;\n",
"    int top = 0;\n",
"    uint node = node_count == 0 ? SBL_END : 1u;\n",
"    // Each turn visits a leaf or changes grids. softpipe leaves this loop only if the number of turns is limited.\n",
"    for (int turns = 4 * node_count + 4; turns > 0; turns--) {\n",
"        while (node < SBL_LEAF) {  // descends to a leaf, to the nearer child first\n",
"            uvec4 first = sbl_node_child_0(int(node)), second = sbl_node_child_1(int(node));\n",
"            int nearest = floatBitsToInt(hit.distance);\n",
"            int a = sbl_box(first, per, offset, flip, nearest), b = sbl_box(second, per, offset, flip, nearest);\n",
"            node = a <= b ? first.w : second.w;\n",
"            if (max(a, b) < 0x7fffffff) stack[++top] = a <= b ? second.w : first.w;\n",
"            if (min(a, b) == 0x7fffffff) node = stack[top--];\n",
"        }\n",
"        bool leaf = true;\n",
"        while ((node & 0xe0000000u) == SBL_ENTER && leaf) {  // SBL_ENTER or SBL_LEAVE: changes to another grid\n",
"            int grid = int(node & SBL_CHILD_NUMBER);\n",
"            per = inverse / sbl_grid_per_length(grid);\n",
"            offset = (sbl_grid_origin(grid) - origin) * inverse;\n",
"            if ((node & 0xf0000000u) == SBL_ENTER) {\n",
"                stack[++top] = SBL_LEAVE | sbl_grid_around(grid);\n",
"                node = sbl_grid_root(grid);\n",
"            } else node = stack[top--];\n",
"            leaf = false;\n",
"        }\n",
"        if (!leaf) continue;\n",
"        if (node == SBL_END) break;\n",
"        int from = int(node & SBL_CHILD_NUMBER), to = from + int(node >> 28 & 7u);\n",
"        for (int t = from; t <= to; t++) sbl_test(t, ray, hit);\n",
"        node = stack[top--];\n",
"    }\n",
"    return hit;\n",
"}\n",
"\n",
"// Returns the nearest hit whose distance is below `limit`. Rays continue behind holes.\n",
"sbl_Hit sbl_trace(vec3 origin, vec3 direction, float limit) {\n",
"    sbl_Hit hit = sbl_Hit(0.0, -1, 0x7fffffff, 0.0, 0.0, false);\n",
"    bool solid = false;\n",
"    for (int hole = 0; hole < SBL_HOLES && !solid; hole++) {\n",
"        hit = sbl_nearest(origin, direction, hit.distance, hit.number, limit);\n",
"        solid = true;\n",
"#ifdef SBL_CUTOUTS\n",
"        if (hit.triangle >= 0 && sbl_triangle_cutout(hit.triangle) != 0u)\n",
"            solid = !sbl_material(int(sbl_triangle_object(hit.triangle)), sbl_attributes_of(hit)).cut_out;\n",
"#endif\n",
"    }\n",
"    return hit;\n",
"}\n",
0 };
/* <<glsl */

/* ======================================================================================================== >>lamps
   Lamps, which sensors send rays to: emitting triangles, lights, and texels of the environment that are too bright for
   random rays. Two trees, one of near lamps and one of distant lamps, hold clusters of neighbours, so that a sensor's
   work grows with the logarithm of the number of lamps (lamps.glsl). One table holds the nodes in preorder, then the
   leaves in the order of the nodes, then the lights.

   The power of a lamp is its radiant intensity along its normal, summed over the channels and divided by pi: R at
   distance d is about power * cosine / d^2. For a distant lamp, R is power * cosine. */

/* A node of a lamp tree. middle, radius: a ball around all lamps of its subtree. power: the sum of their powers.
   square, mixed: the elements xx, yy, zz and xy, yz, zx of a matrix, see sbl__cluster_write. front: sum of power *
   normal / 2 of one-sided lamps. beyond: number of the node after the subtree; SBL_FAR_NODE is set for distant lamps.
   first_leaf: number of the subtree's first leaf */
#define SBL__LAMP_NODE(X) \
    X(sbl__lamp_node, VEC3, middle) X(sbl__lamp_node, FLOAT, radius) \
    X(sbl__lamp_node, VEC3, square) X(sbl__lamp_node, FLOAT, power) \
    X(sbl__lamp_node, VEC3, mixed) X(sbl__lamp_node, UINT, beyond) \
    X(sbl__lamp_node, VEC3, front) X(sbl__lamp_node, UINT, first_leaf)
SBL__RECORD(sbl__lamp_node, SBL__LAMP_NODE, "sbl_lamp_node", "sbl_lamps", SBL__SCENE_TABLE("sbl_lamps"), NULL)

/* A leaf of a lamp tree: one lamp. code: kind << SBL_LAMP_KIND_SHIFT | number. The number is a triangle's place in the
   hierarchy's order, a light's number, or a texel's row * width + column. */
#define SBL__LAMP_LEAF(X) X(sbl__lamp_leaf, UINT, code) X(sbl__lamp_leaf, UVEC3, unused)
SBL__RECORD(sbl__lamp_leaf, SBL__LAMP_LEAF, "sbl_lamp_leaf", "sbl_lamps", "", "sbl_first_leaf")

/* position: for a far light, the direction towards it. radius: for a far light, the squared sine of half its angle.
   A spot's intensity is multiplied by the square of spot_scale * cosine to its axis + spot_offset. */
#define SBL__LIGHT_RECORD(X) \
    X(sbl__light_record, VEC3, position) X(sbl__light_record, FLOAT, radius) \
    X(sbl__light_record, VEC3, intensity) X(sbl__light_record, FLOAT, spot_scale) \
    X(sbl__light_record, VEC3, axis) X(sbl__light_record, FLOAT, spot_offset)
SBL__RECORD(sbl__light_record, SBL__LIGHT_RECORD, "sbl_light", "sbl_lamps", "", "sbl_first_light")

#define SBL__POWER_MOST 1e37          /* upper limit of a lamp's power, so that sums remain finite floats */
#define SBL__POWER_LEAST 1e-30        /* lower limit of pi * power of an emitting triangle, so that it is not skipped */
#define SBL__MOMENT_MOST 1e18         /* upper limit of the sums in a cluster, so that products of two remain finite */
#define SBL__SPOT_LEAST 0.001         /* least difference between the cosines of a spot's cones (KHR_lights_punctual) */
#define SBL__CURVE_BITS 20            /* bits of the Morton curve per axis */
#define SBL__LAMP_DEPTH 128           /* size of the stack `clusters`: above 61 (curve bits) + log2(lamps at a place) */

typedef struct sbl__lamp {
    uint64_t curve;            /* position along a Morton curve; bit 63 is set for distant lamps */
    uint32_t code;             /* see sbl__lamp_leaf */
    sbl__box bounds;
    float normal[3];           /* 0: the lamp shines in all directions; for a distant lamp, the direction towards it */
    float power;
    int one_sided, distant;
} sbl__lamp;

typedef struct sbl__cluster { double power, all_sides, square[6], front[3]; sbl__box bounds; } sbl__cluster;

typedef struct sbl__lamps {    /* data for building the lamp trees */
    sbl__stages stages;
    const sbl__device *device;
    const sbl__geometry *geometry;
    const sbl__hierarchy *hierarchy;
    const sbl__environment *environment;
    struct sbl__lights *lights;
    sbl__lamp *list, *sorted;  /* all lamps; the array that the merge sort writes */
    int count, room;
    double low[3], side;       /* cube around the centres of the near lamps, which the Morton curve fills */
    int width;                 /* merge sort: length of the sorted runs that are merged now, in lamps */
    int left, right, out;      /* next lamps of the two runs to merge; next place in `sorted` */
    sbl__lamp_node *nodes;
    int node_count;
    sbl__cluster clusters[SBL__LAMP_DEPTH];  /* stack: clusters of finished subtrees that are not joined yet */
    int depth;                 /* number of clusters on the stack */
} sbl__lamps;

typedef struct sbl__lights {
    sbl_light *list;           /* copy of the host's lights */
    int count;
    float unit;                /* lamps.glsl divides radiance by this, so that sums do not overflow: about the
                                  largest R that a lamp causes close to it */
    int ready;
    sbl__table table;
    int nodes, leaves;         /* counts of nodes and of leaves, over both trees */
    int mixed;                 /* 1 if not all lamps are triangles, or if there are more than SBL__LAMPS */
    uint32_t *codes;           /* code of each leaf, see sbl__lamp_leaf */
    sbl__lamps *building;
} sbl__lights;

static void sbl__lamps_free(const sbl__device *d, sbl__lamps *l) {
    if (!l) return;
    sbl__free(d->base, l->list);
    sbl__free(d->base, l->sorted);
    sbl__free(d->base, l->nodes);
    sbl__free(d->base, l);
}

static void sbl__lights_free(const sbl__device *d, sbl__lights *l) {
    sbl__lamps_free(d, l->building);
    sbl__free(d->base, l->list);
    sbl__free(d->base, l->codes);
    sbl__table_delete(d, &l->table);
    memset(l, 0, sizeof *l);
}

/* Copies the host's lights, which have been checked. brightest, extent: see sbl__scene, sbl__geometry */
static sbl_result sbl__lights_make(sbl__base *base, sbl__lights *l, const sbl_light *lights, int count,
                                   float brightest, float extent) {
    int i;
    l->count = count;
    l->list = (sbl_light *)sbl__alloc(base, (size_t)l->count, sizeof(sbl_light));
    if (!l->list) return SBL_ERROR_OUT_OF_MEMORY;
    if (l->count) memcpy(l->list, lights, (size_t)l->count * sizeof(sbl_light));
    l->unit = brightest;
    for (i = 0; i < l->count; i++) {
        double intensity = sbl__max3(l->list[i].intensity);
        if (l->list[i].kind != SBL_LIGHT_DIRECTIONAL) intensity = intensity / extent / extent;
        l->unit = SBL__MAX(l->unit, (float)SBL__MIN(intensity, SBL__POWER_MOST));
    }
    l->unit = SBL__MAX(l->unit, 1e-30f);
    return SBL_SUCCESS;
}

/* >>lamps: collecting */

/* Makes a lamp that shines in all directions, or a distant lamp. middle: its position, or the direction towards it.
   around: half the side of its bounds. power: pi * the lamp's power */
static void sbl__lamp_make(sbl__lamp *lamp, uint32_t code, const double middle[3], double around, double power,
                           int distant) {
    int k;
    lamp->code = code;
    lamp->distant = distant;
    lamp->power = (float)SBL__MIN(power / SBL__PI, SBL__POWER_MOST);
    for (k = 0; k < 3; k++) {
        lamp->bounds.low[k] = (float)(middle[k] - around);
        lamp->bounds.high[k] = (float)(middle[k] + around);
        if (distant) lamp->normal[k] = (float)middle[k];
    }
}

/* Makes the lamp of the triangle at a place of the hierarchy's order, if the triangle emits light. */
static void sbl__lamp_of_triangle(const sbl__lamps *l, int place, sbl__lamp *lamp) {
    const uint32_t number = l->hierarchy->order[place];
    const sbl__object *object;
    const double zero[3] = { 0, 0, 0 };
    double normal[3], area;
    int k;
    if (number == SBL__BVH_DROPPED) return;
    object = sbl__triangle_object(l->geometry, number);
    if (!sbl__emits(object, 0)) return;
    area = sbl__scene_normal(l->geometry, number, normal);
    sbl__lamp_make(lamp, SBL__LAMP_TRIANGLE << SBL__LAMP_KIND_SHIFT | (uint32_t)place, zero, 0,
                   SBL__MAX(area * sbl__emission_sum(object), SBL__POWER_LEAST), 0);
    sbl__box_of_triangle(&lamp->bounds, l->geometry, number);
    for (k = 0; k < 3; k++) lamp->normal[k] = (float)normal[k];
    lamp->one_sided = !sbl__emits(object, 1);
}

/* Makes a light's record. place: receives its position, or the direction towards a directional light. */
static void sbl__light_write(const sbl_light *light, sbl__light_record *record, double place[3]) {
    const int distant = light->kind == SBL_LIGHT_DIRECTIONAL, spot = light->kind == SBL_LIGHT_SPOT;
    const double half = 0.5 * light->angle * SBL__PI / 180, outer = cos(0.5 * SBL__CONE(light) * SBL__PI / 180);
    const double scale = 1 / SBL__MAX(SBL__SPOT_LEAST, cos(0.5 * light->inner_cone * SBL__PI / 180) - outer);
    double axis[3];
    int k;
    for (k = 0; k < 3; k++) axis[k] = light->direction[k];
    sbl__normalize(axis);
    for (k = 0; k < 3; k++) {
        place[k] = distant ? -axis[k] : light->position[k];
        record->position[k] = (float)place[k];
        record->intensity[k] = light->intensity[k];
        record->axis[k] = (float)(spot ? axis[k] : 0);
    }
    record->radius = (float)(distant ? sin(half) * sin(half) : light->radius);
    record->spot_scale = (float)(spot ? scale : 0);
    record->spot_offset = (float)(spot ? -outer * scale : 1);
}

static void sbl__lamp_of_light(const sbl__lamps *l, int number, sbl__lamp *lamp) {
    const sbl_light *light = &l->lights->list[number];
    const int distant = light->kind == SBL_LIGHT_DIRECTIONAL;
    const uint32_t kind = distant ? SBL__LAMP_FAR_LIGHT : SBL__LAMP_NEAR_LIGHT;
    double place[3], half = 0.5 * light->angle * SBL__PI / 180;
    sbl__light_record record;
    sbl__light_write(light, &record, place);
    sbl__lamp_make(lamp, kind << SBL__LAMP_KIND_SHIFT | (uint32_t)number, place,
                   distant ? 2 * sin(0.5 * half) : light->radius, sbl__sum3(light->intensity), distant);
}

static void sbl__lamp_of_texel(const sbl__environment *e, int at, sbl__lamp *lamp) {
    const int x = at % e->width, y = at / e->width;
    const float *c = e->pixels + 4 * (size_t)at;
    const double step = SBL__PI / e->height;
    const double solid_angle = 2 * SBL__PI / e->width * 2 * sin(step * (y + 0.5)) * sin(0.5 * step);
    double direction[3];
    if (!(sbl__max3(c) > e->limit)) return;
    sbl__environment_direction(e, x, y, direction);
    sbl__lamp_make(lamp, SBL__LAMP_SKY_TEXEL << SBL__LAMP_KIND_SHIFT | (uint32_t)at, direction,
                   SBL__MIN(step + 2 * SBL__PI / e->width, 1.0),
                   sbl__sum3(c) * (1 - e->limit / sbl__max3(c)) * solid_angle, 1);
}

/* Returns the number of triangles, lights and texels, which sbl__lamps_add takes in this order. */
static int sbl__lamps_candidates(void *work) {
    const sbl__lamps *l = (const sbl__lamps *)work;
    const sbl__environment *e = l->environment;
    return l->hierarchy->triangle_count + l->lights->count + (e->pixels ? e->width * e->height : 0);
}

/* Adds a lamp if candidate `at` emits light. */
static sbl_result sbl__lamps_add(void *work, int at) {
    sbl__lamps *l = (sbl__lamps *)work;
    const int light = at - l->hierarchy->triangle_count, texel = light - l->lights->count;
    sbl__lamp lamp;
    memset(&lamp, 0, sizeof lamp);
    if (light < 0) sbl__lamp_of_triangle(l, at, &lamp);
    else if (texel < 0) sbl__lamp_of_light(l, light, &lamp);
    else sbl__lamp_of_texel(l->environment, texel, &lamp);
    if (!(lamp.power > 0)) return SBL_SUCCESS;
    if (!sbl__grow(l->device->base, &l->list, &l->room, l->count + 1, sizeof *l->list)) return SBL_ERROR_OUT_OF_MEMORY;
    l->list[l->count++] = lamp;
    return SBL_SUCCESS;
}

/* Returns an upper bound of the number of lamps, for the size of the table. */
static double sbl__lamps_most(const sbl__geometry *g, const sbl__environment *e, int light_count) {
    double lamps = light_count;
    size_t i;
    for (i = 0; i < (size_t)g->mesh_count; i++)
        if (sbl__emits(&g->objects[i], 0)) lamps += g->meshes[i].triangle_count;
    for (i = 0; e->pixels && i < (size_t)e->width * (size_t)e->height; i++)
        lamps += sbl__max3(e->pixels + 4 * i) > e->limit;
    return lamps;
}

/* >>lamps: sorting along a Morton curve, near lamps before distant lamps */

static double sbl__box_middle(const sbl__box *b, int k) { return 0.5 * ((double)b->high[k] + b->low[k]); }

static uint64_t sbl__lamp_curve(const sbl__lamps *l, const sbl__lamp *lamp) {
    uint64_t curve = (uint64_t)lamp->distant << 63;
    int k, bit;
    for (k = 0; k < 3; k++) {
        const double middle = sbl__box_middle(&lamp->bounds, k);
        const double share = lamp->distant ? 0.25 * (middle + 2) : l->side > 0 ? (middle - l->low[k]) / l->side : 0;
        const uint64_t place = (uint64_t)(SBL__MIN(SBL__MAX(share, 0.0), 1.0) * ((1 << SBL__CURVE_BITS) - 1));
        for (bit = 0; bit < SBL__CURVE_BITS; bit++) curve |= (place >> bit & 1u) << (3 * bit + k);
    }
    return curve;
}

/* Merges runs of l->width lamps, then runs twice as long, until one run is left. The sort is stable. */
static sbl_result sbl__lamps_sort(void *work, sbl__slice *slice) {
    sbl__lamps *l = (sbl__lamps *)work;
    for (; l->width < l->count; l->width *= 2, l->out = 0) {
        while (l->out < l->count) {
            const int run = l->out / (2 * l->width) * (2 * l->width);
            const int middle = SBL__MIN(run + l->width, l->count), end = SBL__MIN(run + 2 * l->width, l->count);
            if (l->out == run) { l->left = run; l->right = middle; }
            if (sbl__late(slice)) return SBL_UNFINISHED;
            if (l->right == end || (l->left < middle && l->list[l->left].curve <= l->list[l->right].curve))
                l->sorted[l->out++] = l->list[l->left++];
            else l->sorted[l->out++] = l->list[l->right++];
        }
        { sbl__lamp *swap = l->list; l->list = l->sorted; l->sorted = swap; }
    }
    return SBL_SUCCESS;
}

/* >>lamps: the trees. A tree of n leaves has 2 n - 1 nodes, so the end of each subtree is known in advance. */

/* Returns the lamp at which to split lamps low .. high: the first one in whose curve position the highest differing bit
   is set. Lamps with equal curve positions are split in the middle. */
static int sbl__lamps_cut(const sbl__lamps *l, int low, int high) {
    uint64_t differs = l->list[low].curve ^ l->list[high].curve;
    if (!differs) return low + (high - low + 1) / 2;
    while (differs & (differs - 1)) differs &= differs - 1;
    while (high - low > 1) {
        const int middle = low + (high - low) / 2;
        if (l->list[middle].curve & differs) high = middle;
        else low = middle;
    }
    return high;
}

/* Makes node `at` the root of the subtree of `count` lamps from lamp `first` on. Returns the number of the node after
   the subtree. */
static int sbl__lamps_root(sbl__lamps *l, int at, int first, int count) {
    if (!count) return at;
    l->nodes[at].first_leaf = (uint32_t)first;
    l->nodes[at].beyond = (uint32_t)(at + 2 * count - 1);
    return at + 2 * count - 1;
}

/* Makes the roots of the tree of near lamps and of the tree of distant lamps. The lamps are sorted already. */
static int sbl__lamps_plant(void *work) {
    sbl__lamps *l = (sbl__lamps *)work;
    int near_count = 0;
    while (near_count < l->count && !l->list[near_count].distant) near_count++;
    l->node_count = sbl__lamps_root(l, sbl__lamps_root(l, 0, 0, near_count), near_count, l->count - near_count);
    return l->stages.stage + 1;
}

static int sbl__lamps_nodes(void *work) { return ((sbl__lamps *)work)->node_count; }

/* Makes the roots of a node's two subtrees, which follow the node. */
static sbl_result sbl__lamps_split(void *work, int at) {
    sbl__lamps *l = (sbl__lamps *)work;
    const int first = (int)l->nodes[at].first_leaf, end = first + ((int)l->nodes[at].beyond - at + 1) / 2;
    if (end - first > 1) {
        const int cut = sbl__lamps_cut(l, first, end - 1);
        sbl__lamps_root(l, sbl__lamps_root(l, at + 1, first, cut - first), cut, end - cut);
    }
    return SBL_SUCCESS;
}

static void sbl__cluster_of_lamp(sbl__cluster *c, const sbl__lamp *lamp) {
    /* axes of the products xx yy zz xy yz zx of sbl__lamp_node */
    static const int pairs[6][2] = { { 0, 0 }, { 1, 1 }, { 2, 2 }, { 0, 1 }, { 1, 2 }, { 2, 0 } };
    const int sides = !sbl__all_zero(lamp->normal, 3), front = lamp->one_sided || lamp->distant;
    /* A lamp with one side emits in proportion to max(x, 0) = |x| / 2 + x / 2, where x is the cosine at the lamp. The
       products below hold the part with |x|, c->front the part with x. */
    const double shown = front ? 0.5 * lamp->power : lamp->power;
    int k;
    c->power = lamp->power;
    c->all_sides = shown;
    for (k = 0; k < 6; k++)
        c->square[k] = sides ? shown * lamp->normal[pairs[k][0]] * lamp->normal[pairs[k][1]] : k < 3 ? shown : 0;
    for (k = 0; k < 3; k++) c->front[k] = front ? shown * lamp->normal[k] : 0;
    c->bounds = lamp->bounds;
}

static void sbl__cluster_add(sbl__cluster *c, const sbl__cluster *other) {
    int k;
    c->power += other->power;
    c->all_sides += other->all_sides;
    for (k = 0; k < 6; k++) c->square[k] += other->square[k];
    for (k = 0; k < 3; k++) c->front[k] += other->front[k];
    sbl__box_add(&c->bounds, &other->bounds);
}

static void sbl__cluster_write(const sbl__cluster *c, int distant, sbl__lamp_node *node) {
    const double all_sides = SBL__MIN(c->all_sides, SBL__MOMENT_MOST);
    double radius = 0;
    int k;
    for (k = 0; k < 3; k++) {
        const double side = 0.5 * ((double)c->bounds.high[k] - c->bounds.low[k]);
        const double mixed = SBL__MAX(SBL__MIN(c->square[3 + k], SBL__MOMENT_MOST), -SBL__MOMENT_MOST);
        radius += side * side;
        node->middle[k] = (float)sbl__box_middle(&c->bounds, k);
        /* The matrix all_sides * sum of power * n * n^T bounds the sum of power * |n . w| in a direction w, squared
           (Cauchy-Schwarz inequality). */
        node->square[k] = (float)(all_sides * SBL__MIN(c->square[k], SBL__MOMENT_MOST));
        node->mixed[k] = (float)(all_sides * mixed);
        node->front[k] = (float)c->front[k];
    }
    node->radius = (float)(1.000001 * sqrt(radius));
    node->power = (float)c->power;
    if (distant) node->beyond |= SBL__FAR_NODE;
}

/* Computes the cluster of a node's lamps. Nodes are visited from last to first, so that the clusters of a node's
   halves lie on the stack, the left one on top. */
static sbl_result sbl__lamps_add_up(void *work, int at) {
    sbl__lamps *l = (sbl__lamps *)work;
    const int number = l->node_count - 1 - at;
    sbl__lamp_node *node = &l->nodes[number];
    const sbl__lamp *lamp = &l->list[node->first_leaf];
    if ((int)node->beyond == number + 1) sbl__cluster_of_lamp(&l->clusters[l->depth++], lamp);
    else {
        l->depth--;
        sbl__cluster_add(&l->clusters[l->depth - 1], &l->clusters[l->depth]);
    }
    sbl__cluster_write(&l->clusters[l->depth - 1], lamp->distant, node);
    return SBL_SUCCESS;
}

/* >>lamps: stages */

static sbl_result sbl__lamps_place(void *work, sbl__slice *slice) {
    sbl__lamps *l = (sbl__lamps *)work;
    sbl__base *base = l->device->base;
    int i, k;
    (void)slice;
    l->low[0] = l->low[1] = l->low[2] = DBL_MAX;
    for (i = 0; i < l->count; i++)
        for (k = 0; k < 3 && !l->list[i].distant; k++)
            l->low[k] = SBL__MIN(l->low[k], sbl__box_middle(&l->list[i].bounds, k));
    for (i = 0; i < l->count; i++)
        for (k = 0; k < 3 && !l->list[i].distant; k++)
            l->side = SBL__MAX(l->side, sbl__box_middle(&l->list[i].bounds, k) - l->low[k]);
    for (i = 0; i < l->count; i++) l->list[i].curve = sbl__lamp_curve(l, &l->list[i]);
    l->sorted = (sbl__lamp *)sbl__alloc_raw(base, (size_t)l->count, sizeof *l->sorted);
    l->nodes = (sbl__lamp_node *)sbl__alloc_raw(base, 2 * (size_t)l->count, sizeof *l->nodes);
    l->width = 1;
    return l->sorted && l->nodes ? SBL_SUCCESS : SBL_ERROR_OUT_OF_MEMORY;
}

static sbl_result sbl__lamps_store(void *work, sbl__slice *slice) {
    sbl__lamps *l = (sbl__lamps *)work;
    const sbl__device *d = l->device;
    sbl__lights *lights = l->lights;
    const size_t nodes = sizeof(sbl__lamp_node) * (size_t)l->node_count;
    const size_t leaves = sizeof(sbl__lamp_leaf) * (size_t)l->count;
    const size_t bytes = nodes + leaves + sizeof(sbl__light_record) * (size_t)lights->count;
    unsigned char *all = (unsigned char *)sbl__alloc(d->base, bytes, 1);
    sbl_result result = SBL_ERROR_OUT_OF_MEMORY;
    double place[3];
    int i;
    (void)slice;
    sbl__free(d->base, lights->codes);
    lights->codes = (uint32_t *)sbl__alloc_raw(d->base, (size_t)l->count, sizeof *lights->codes);
    if (all && lights->codes) {
        sbl__lamp_leaf *leaf = (sbl__lamp_leaf *)(void *)(all + nodes);
        sbl__light_record *record = (sbl__light_record *)(void *)(all + nodes + leaves);
        lights->nodes = l->node_count;
        lights->leaves = l->count;
        lights->mixed = l->count > SBL__LAMPS;
        memcpy(all, l->nodes, nodes);
        for (i = 0; i < l->count; i++) {
            leaf[i].code = lights->codes[i] = l->list[i].code;
            lights->mixed |= leaf[i].code >> SBL__LAMP_KIND_SHIFT != SBL__LAMP_TRIANGLE;
        }
        for (i = 0; i < lights->count; i++) sbl__light_write(&lights->list[i], &record[i], place);
        result = sbl__buffer_make(d, &lights->table.buffer, bytes, all, SBL__GL_STATIC_DRAW);
        if (result == SBL_SUCCESS) result = sbl__table_attach(d, &lights->table, SBL__GL_RGBA32UI, l->geometry->wide);
        if (l->geometry->wide) sbl__buffer_delete(d, &lights->table.buffer);
    }
    sbl__free(d->base, all);
    return result;
}

/* Sets the inputs of lamp.glsl. */
static void sbl__lights_bind(sbl__device *d, const sbl__lights *l) {
    const int leaf = (int)sizeof(sbl__lamp_node) / 16 * l->nodes;
    sbl__bind_table(d, "sbl_lamps", &l->table);
    sbl__set_int(d, "sbl_first_leaf", leaf);
    sbl__set_int(d, "sbl_first_light", leaf + l->leaves);
    sbl__set_int(d, "lamp_nodes", l->nodes);
    sbl__set_int(d, "lamp_leaves", l->leaves);
    sbl__set_float(d, "unit", l->unit);
}

/* Collects the lamps of a scene whose hierarchy is ready, and builds their trees. It can begin again after an error. */
static sbl_result sbl__lights_step(sbl__device *d, const sbl__geometry *g, const sbl__hierarchy *h,
                                   const sbl__environment *e, sbl__lights *lights, sbl__slice *slice) {
    static const sbl__stage_row table[] = {
        { NULL, NULL, sbl__lamps_add, sbl__lamps_candidates },
        { sbl__lamps_place, NULL, NULL, NULL },
        { sbl__lamps_sort, sbl__lamps_plant, NULL, NULL },
        { NULL, NULL, sbl__lamps_split, sbl__lamps_nodes },
        { NULL, NULL, sbl__lamps_add_up, sbl__lamps_nodes },
        { sbl__lamps_store, NULL, NULL, NULL }
    };
    sbl__lamps *l = lights->building;
    sbl_result result;
    if (lights->ready) return SBL_SUCCESS;
    d->gl.doing = "storing lamps";
    if (!l) lights->building = l = (sbl__lamps *)sbl__alloc(d->base, 1, sizeof *l);
    if (!l) return SBL_ERROR_OUT_OF_MEMORY;
    l->device = d;
    l->geometry = g;
    l->hierarchy = h;
    l->environment = e;
    l->lights = lights;
    result = sbl__stages_run(&l->stages, table, SBL__COUNT(table), l, slice);
    if (result == SBL_UNFINISHED) return result;
    lights->ready = result == SBL_SUCCESS;
    sbl__lamps_free(d, l);
    lights->building = NULL;
    return result;
}

/* ======================================================================================================== >>store
   Holds the bounced light of the scene: R on all surfaces, cell by cell. >>bounce computes it. Sensors read it at the
   surfaces that they see.

   Surfaces are divided into patches: neighbouring triangles of a mesh that form one smooth surface. A cell is the part
   of one side of a patch that lies in one cube of a grid over the scene and faces one of six directions. For a flat
   patch, whose plane may coincide with a plane of the grid, a column of cubes replaces the cube. Therefore light does
   not leak through walls, between shelves or around edges; tiny triangles share a cell, and large triangles have many.
   Where an object stands on a surface, the plane of the object cuts the cell into two leaves (see >>bounce). Cells
   have the same size at first; once there are many, new surfaces get wider cells, of level 1 or 2.

       triangle -> patch, side \
                                hash grid -> leaf, or cut -> ... -> leaf: R
       position -> cube        /                                                                                  */

/* A slot of the hash grid. check: a second hash of the cell, 0 if the slot is free. reference: the number of a leaf
   plus 1, the number of a cut plus SBL__CELL_CUT, or 0 if the cell has no leaf. */
typedef struct sbl__cell_slot { uint32_t check, reference; } sbl__cell_slot;

/* A plane that divides a cell. sides: references, like those of slots, to the parts where dot(normal, position) is at
   most `distance`, and where it is larger. */
#define SBL__CUT(X) \
    X(sbl__cut, VEC3, normal) X(sbl__cut, FLOAT, distance) \
    X(sbl__cut, UVEC2, sides) X(sbl__cut, UVEC2, unused)
SBL__RECORD(sbl__cut, SBL__CUT, "sbl_cut", "sbl_store", SBL__SCENE_TABLE("sbl_store"), "first_cut")

/* light: R; the low bits of its blue hold the uncertainty. lamps: the part of R that comes directly from lamps, packed
   by sbl__rgbe. */
#define SBL__LEAF_RECORD(X) X(sbl__leaf, VEC3, light) X(sbl__leaf, UINT, lamps)
SBL__RECORD(sbl__leaf, SBL__LEAF_RECORD, "sbl_leaf", "sbl_store", "", "first_leaf")

typedef struct sbl__store {
    int ready;
    int warned;                /* 1: the warning about clamped albedos has been logged */
    float origin[3], length;   /* origin of the grid; length of a cell of level 0 */
    uint32_t *patches;         /* one word per triangle, see sbl__patch_word */
    sbl__cell_slot *cells;     /* slots of the hash grid, also free ones */
    int cell_room;             /* number of elements of `cells`: a power of two, or 0 if `cells` is NULL */
    sbl__cut *cuts;
    sbl__leaf *leaves;
    int cut_count, cut_room, leaf_count, leaf_room;
    int max_leaves;
    int made_for;              /* max_leaves when the light was made, which may have been in an earlier run */
    float brightest;           /* largest channel of R in any leaf */
    float air[6][3];           /* for objects that the host draws: mean R where they face +x, -x, +y, -y, +z, -z */
    sbl__table table;          /* patches, cells, cuts and leaves in one table, because texture units are few */
    int first_cell, first_cut, first_leaf;  /* start of each part in the table, in texels of four words */
} sbl__store;

static void sbl__store_free(const sbl__device *d, sbl__store *s) {
    sbl__free(d->base, s->patches);
    sbl__free(d->base, s->cells);
    sbl__free(d->base, s->cuts);
    sbl__free(d->base, s->leaves);
    sbl__table_delete(d, &s->table);
    memset(s, 0, sizeof *s);
}

/* >>store: uncertainty. It is 2^(-n / SBL__UNCERTAINTY_STEPS), where n, the low eight bits of blue, is 1 to 255; with
   n = 0 it is unknown. Shaders read these bits as a negligible part of the light. */

#define SBL__UNCERTAINTY_STEPS 16
#define SBL__UNCERTAINTY_LEAST 1e-30f  /* the uncertainty is stored in the last 8 bits of blue, unless blue is
                                          smaller than this */

static void sbl__leaf_set_uncertainty(sbl__leaf *leaf, double uncertainty) {
    const double steps = -SBL__UNCERTAINTY_STEPS * log(SBL__MAX(uncertainty, 1e-9)) / log(2.0);
    const uint32_t step = (uint32_t)SBL__MIN(SBL__MAX(steps, 1.0), 255.0);
    const uint32_t bits = (sbl__float_bits(&leaf->light[2]) & ~255u) | step;
    if (leaf->light[2] >= SBL__UNCERTAINTY_LEAST) memcpy(&leaf->light[2], &bits, sizeof bits);
}

/* Returns the standard error of stored light divided by the light; 0: unknown. */
static float sbl__leaf_uncertainty(const float light[3]) {
    const uint32_t step = light[2] < SBL__UNCERTAINTY_LEAST ? 0 : sbl__float_bits(&light[2]) & 255u;
    return step ? (float)pow(2.0, -(double)step / SBL__UNCERTAINTY_STEPS) : 0;
}

/* >>store: cells. store.glsl finds them in the same way. */

static uint32_t sbl__hash_step(uint32_t hash, uint32_t x) {
    hash = (hash ^ x) * SBL__HASH_FACTOR;
    return hash ^ hash >> SBL__HASH_SHIFT;
}

static float sbl__cell_length(const sbl__store *s, uint32_t patch) {
    const int level = (int)(patch / SBL__PATCH_LEVEL) & 3;
    return s->length * (float)(1 << SBL__LEVEL_SHIFT * level);
}

/* Computes the coordinates of the cube that contains a position, in the grid of the level that the patch word has. */
static void sbl__cell_place(const sbl__store *s, uint32_t patch, const float position[3], uint32_t at[3]) {
    const float per_cell = 1 / sbl__cell_length(s, patch);
    int k;
    for (k = 0; k < 3; k++) {
        const float x = (position[k] - s->origin[k]) * per_cell;
        at[k] = (uint32_t)SBL__MIN(SBL__MAX(x, 0), SBL__CELL_MOST);
    }
    if (patch & SBL__PATCH_FLAT) at[patch >> SBL__PATCH_AXIS_SHIFT & 3u] = 0;
}

/* Returns the reference in the slot of a position's cell. A cell that has no slot gets one; NULL: all slots in reach
   hold other cells. */
static uint32_t *sbl__store_slot(const sbl__store *s, uint32_t patch, const float position[3]) {
    uint32_t at[3], hash, check;
    int i;
    sbl__cell_place(s, patch, position, at);
    hash = sbl__hash_step(sbl__hash_step(sbl__hash_step(sbl__hash_step(0, patch), at[0]), at[1]), at[2]);
    check = sbl__hash_step(sbl__hash_step(sbl__hash_step(hash, at[2]), at[1]), at[0]) | 1u;
    for (i = 0; i < SBL__SLOT_TRIES; i++) {
        sbl__cell_slot *slot = &s->cells[(hash + (uint32_t)i) & (uint32_t)(s->cell_room - 1)];
        if (slot->check == 0) slot->check = check;
        if (slot->check == check) return &slot->reference;
    }
    return NULL;
}

/* Like sbl__store_slot, but follows cuts, so that the reference leads to the leaf at the position or is 0. *depth:
   receives the number of cuts followed. The pointer is valid until a cut is added. */
static uint32_t *sbl__store_find(const sbl__store *s, uint32_t patch, const float position[3], int *depth) {
    uint32_t *reference = sbl__store_slot(s, patch, position);
    for (*depth = 0; reference && *reference >= SBL__CELL_CUT; ++*depth) {
        sbl__cut *cut = &s->cuts[*reference & ~SBL__CELL_CUT];
        reference = &cut->sides[sbl__dot(cut->normal, position) > cut->distance];
    }
    return reference;
}

/* Packs radiance into one word with a shared exponent (Ward 1991, "Real Pixels"). */
static uint32_t sbl__rgbe(const float light[3]) {
    uint32_t word;
    int exponent, k;
    if (!(frexp((double)sbl__max3(light), &exponent) > 0) || exponent < -127) return 0;
    exponent = SBL__MIN(exponent, 127);
    word = (uint32_t)(exponent + SBL__RGBE_BIAS) << 24;
    for (k = 0; k < 3; k++) {
        const double part = ldexp((double)light[k], SBL__RGBE_BITS - exponent) + 0.5;
        word |= (uint32_t)SBL__MIN(SBL__MAX(part, 0), 255.0) << 8 * k;
    }
    return word;
}

/* Makes a reference lead to a new cut. side: the side of the cut that gets the reference's previous value. */
static sbl_result sbl__store_cut(sbl__base *base, sbl__store *s, uint32_t *reference, const float normal[3],
                                 float distance, int side) {
    const uint32_t before = *reference;
    sbl__cut *cut;
    *reference = SBL__CELL_CUT | (uint32_t)s->cut_count;
    if (!sbl__grow(base, &s->cuts, &s->cut_room, s->cut_count + 1, sizeof *s->cuts))
        return SBL_ERROR_OUT_OF_MEMORY;
    cut = &s->cuts[s->cut_count++];
    memset(cut, 0, sizeof *cut);
    memcpy(cut->normal, normal, sizeof cut->normal);
    cut->distance = distance;
    cut->sides[side] = before;
    return SBL_SUCCESS;
}

/* >>store: patches. Triangles of a mesh are joined where they meet at a small angle, at edges with equal positions. */

#define SBL__PATCH_SMOOTH 0.8   /* least cosine between the normals of neighbours in a patch */
#define SBL__PATCH_EVEN 0.9999  /* least cosine between the normals of a flat patch's triangles */
#define SBL__PATCH_LEAST 0.25   /* patches of a mesh with a smaller area, in areas of a cell, are pooled as one */

typedef struct sbl__patch { double area; float normal[3]; sbl__box bounds; int flat; } sbl__patch;

typedef struct sbl__patching {     /* state of dividing the scene into patches */
    sbl__stages stages;
    const sbl__geometry *geometry;
    sbl__hash_table places, ends;  /* finds vertices by their positions, and triangles' sides by their ends */
    uint32_t *welded;              /* for each vertex, the first vertex at the same position */
    uint32_t *corners;             /* three welded vertices per triangle */
    uint32_t *parents;             /* union-find forest of triangles; each root stands for a patch, see sbl__root */
    sbl__patch *patches;           /* one per triangle; a patch is at the index of its root triangle */
    double area;                   /* area of all triangles not hidden from sensors, world units squared */
    double least;                  /* patches with a smaller area are joined into one patch per mesh, world units
                                      squared */
    double growth;                 /* factor of the area of cells; changes after too many or too few leaves */
    double pool;                   /* factor of `least`; changes with `growth`, but never shrinks once above 1 */
} sbl__patching;

static sbl_result sbl__patching_begin(sbl__base *base, sbl__patching *p, const sbl__geometry *g) {
    const size_t triangles = (size_t)g->triangle_count;
    uint32_t i;
    p->geometry = g;
    p->growth = p->pool = 1;
    p->welded = (uint32_t *)sbl__alloc(base, (size_t)g->vertex_count, sizeof *p->welded);
    p->corners = (uint32_t *)sbl__alloc_raw(base, triangles, 3 * sizeof *p->corners);
    p->parents = (uint32_t *)sbl__alloc(base, triangles, sizeof *p->parents);
    p->patches = (sbl__patch *)sbl__alloc(base, triangles, sizeof *p->patches);
    if (!p->welded || !p->corners || !p->parents || !p->patches ||
        sbl__hash_table_make(base, &p->places, g->vertex_count) != SBL_SUCCESS ||
        sbl__hash_table_make(base, &p->ends, 3.0 * g->triangle_count) != SBL_SUCCESS) return SBL_ERROR_OUT_OF_MEMORY;
    for (i = 0; i < triangles; i++) p->parents[i] = i;
    return SBL_SUCCESS;
}

static int sbl__patching_vertices(void *work) { return ((sbl__patching *)work)->geometry->vertex_count; }
static int sbl__patching_triangles(void *work) { return ((sbl__patching *)work)->geometry->triangle_count; }

static sbl_result sbl__patch_weld(void *work, int at) {
    sbl__patching *p = (sbl__patching *)work;
    p->welded[at] = sbl__hash_table_first(&p->places, sbl__place_hash(p->geometry, (uint32_t)at), (uint32_t)at,
                                          sbl__same_place, p->geometry);
    return SBL_SUCCESS;
}

static sbl_result sbl__patch_join(void *work, int at) {
    sbl__patching *p = (sbl__patching *)work;
    const sbl__geometry *g = p->geometry;
    const uint32_t triangle = (uint32_t)at;
    double normal[3], other[3];
    size_t k;
    for (k = 3 * (size_t)triangle; k < 3 * (size_t)triangle + 3; k++) p->corners[k] = p->welded[g->indices[k]];
    sbl__scene_normal(g, triangle, normal);
    for (k = 0; k < 3; k++) {
        const uint32_t side = 3 * triangle + (uint32_t)k, first = sbl__first_side(&p->ends, p->corners, side);
        if (first == side) continue;
        sbl__scene_normal(g, first / 3, other);
        if (normal[0] * other[0] + normal[1] * other[1] + normal[2] * other[2] < SBL__PATCH_SMOOTH) continue;
        sbl__join(p->parents, triangle, first / 3);
    }
    return SBL_SUCCESS;
}

/* Adds a triangle to its patch's bounds and, unless hidden from sensors, area. Tests whether the patch is flat. */
static sbl_result sbl__patch_measure(void *work, int at) {
    sbl__patching *p = (sbl__patching *)work;
    const sbl__geometry *g = p->geometry;
    const uint32_t triangle = (uint32_t)at, root = sbl__root(p->parents, triangle);
    sbl__patch *patch = &p->patches[root];
    double normal[3], cosine = 0;
    const double area = sbl__scene_normal(g, triangle, normal);
    sbl__box box;
    int k;
    if (triangle == root) {  /* A root has the smallest number in its patch, so the stage visits it first. */
        patch->flat = 1;
        for (k = 0; k < 3; k++) patch->normal[k] = (float)normal[k];
        patch->bounds = sbl__box_empty;
    }
    sbl__box_of_triangle(&box, g, triangle);
    sbl__box_add(&patch->bounds, &box);
    if (!(sbl__triangle_object(g, triangle)->flags & SBL_MATERIAL_HIDDEN_FROM_SENSORS)) {
        patch->area += area;
        p->area += area;
    }
    for (k = 0; k < 3; k++) cosine += normal[k] * patch->normal[k];
    if (cosine < SBL__PATCH_EVEN) patch->flat = 0;
    return SBL_SUCCESS;
}

/* Returns the patch word of a triangle: the number of its patch (small patches of a mesh share one), the largest
   axis of its normal, SBL__PATCH_FLAT if the patch is plane, and SBL__PATCH_BACK if the normal is negative on that
   axis. */
static uint32_t sbl__patch_word(sbl__patching *p, uint32_t triangle) {
    const sbl__geometry *g = p->geometry;
    const uint32_t root = sbl__root(p->parents, triangle);
    const uint32_t mesh = (uint32_t)(sbl__triangle_object(g, triangle) - g->objects);
    const int pooled = p->patches[root].area < p->least;
    const uint32_t number = pooled ? (uint32_t)g->triangle_count + mesh : root;
    uint32_t axis = 0;
    double n[3];
    sbl__scene_normal(g, triangle, n);
    if (fabs(n[1]) > fabs(n[0])) axis = 1;
    if (fabs(n[2]) > fabs(n[axis])) axis = 2;
    return number << SBL__PATCH_SHIFT | axis << SBL__PATCH_AXIS_SHIFT |
           (p->patches[root].flat && !pooled ? SBL__PATCH_FLAT : 0) | (n[axis] < 0 ? SBL__PATCH_BACK : 0);
}

static sbl_result sbl__patching_step(sbl__patching *p, sbl__slice *slice) {
    static const sbl__stage_row table[] = {
        { NULL, NULL, sbl__patch_weld, sbl__patching_vertices },
        { NULL, NULL, sbl__patch_join, sbl__patching_triangles },
        { NULL, NULL, sbl__patch_measure, sbl__patching_triangles }
    };
    return sbl__stages_step(&p->stages, table, SBL__COUNT(table), p, slice);
}

/* >>store: on the GPU */

static sbl_result sbl__store_send(const sbl__device *d, sbl__store *s, const sbl__geometry *g) {
    sbl__buffer *buffer = &s->table.buffer;
    sbl_result result;
    int i;
    for (i = 0, s->brightest = 0; i < s->leaf_count; i++)
        s->brightest = SBL__MAX(s->brightest, sbl__max3(s->leaves[i].light));
    s->first_cell = g->triangle_count / 4 + 1;
    s->first_cut = s->first_cell + s->cell_room / 2;
    s->first_leaf = s->first_cut + 2 * s->cut_count;
    result = sbl__buffer_make(d, buffer, 16 * ((size_t)s->first_leaf + (size_t)s->leaf_count), NULL,
                              SBL__GL_STATIC_DRAW);
    if (result != SBL_SUCCESS) return result;
    sbl__buffer_write(d, buffer, 0, sizeof *s->patches * (size_t)g->triangle_count, s->patches);
    sbl__buffer_write(d, buffer, 16 * (size_t)s->first_cell, sizeof *s->cells * (size_t)s->cell_room, s->cells);
    sbl__buffer_write(d, buffer, 16 * (size_t)s->first_cut, sizeof *s->cuts * (size_t)s->cut_count, s->cuts);
    sbl__buffer_write(d, buffer, 16 * (size_t)s->first_leaf, sizeof *s->leaves * (size_t)s->leaf_count, s->leaves);
    return sbl__table_attach(d, &s->table, SBL__GL_RGBA32UI, g->wide);
}

/* Sets the inputs of store.glsl. */
static void sbl__store_bind(sbl__device *d, const sbl__store *s) {
    sbl__bind_table(d, "sbl_store", &s->table);
    sbl__set_int(d, "first_cell", s->first_cell);
    sbl__set_int(d, "first_cut", s->first_cut);
    sbl__set_int(d, "first_leaf", s->first_leaf);
    sbl__set_vec3(d, "cell_origin", s->origin);
    sbl__set_float(d, "per_cell", 1 / s->length);
    sbl__set_int(d, "cell_mask", s->cell_room - 1);
}

/* >>glsl frame: shaders_embedded/frame.glsl, copied by scripts/embed_shaders */
static const char *const sbl__glsl_frame[] = {
"// Returns a right-handed orthonormal basis whose third column is the unit vector n (Duff et al. 2017, \"Building\n",
"// an Orthonormal Basis, Revisited\").\n",
"mat3 sbl_frame(vec3 n) {\n",
"    float s = n.z < 0.0 ? -1.0 : 1.0, f = -1.0 / (s + n.z), g = n.x * n.y * f;\n",
"    return mat3(1.0 + s * n.x * n.x * f, s * g, -s * n.x, g, s + n.y * n.y * f, -n.y, n);\n",
"}\n",
"\n",
"// Maps a uniform point u of the unit square to a cosine-distributed direction over the hemisphere about the\n",
"// frame's third column.\n",
"vec3 sbl_by_cosine(mat3 frame, vec2 u) {\n",
"    float radius = sqrt(u.x), angle = 2.0 * SBL_PI * u.y;\n",
"    return frame * vec3(radius * cos(angle), radius * sin(angle), sqrt(1.0 - u.x));\n",
"}\n",
0 };
/* <<glsl */

/* >>glsl store: shaders_embedded/store.glsl, copied by scripts/embed_shaders */
static const char *const sbl__glsl_store[] = {
"// The store of bounced light (see >>store in sbl.h): R on surfaces, cell by cell.\n",
"#ifdef SBL_BOUNCED\n",
"// The table sbl_store holds the patch words of all triangles, the hash table of cells, cuts, and leaves.\n",
"uniform int first_cell;    // texel at which the hash table begins; each texel holds two slots (check, reference)\n",
"uniform int cell_mask;     // number of slots in the hash table - 1\n",
"uniform vec3 cell_origin;  // origin of the grid of cells\n",
"uniform float per_cell;    // 1 / length of a cell of level 0\n",
"\n",
"uint sbl_hash_step(uint hash, uint x) {\n",
"    hash = (hash ^ x) * SBL_HASH_FACTOR;\n",
"    return hash ^ hash >> SBL_HASH_SHIFT;\n",
"}\n",
"\n",
"// True if rays of this length read cells for near rays.\n",
"bool sbl_is_near(float distance) { return distance * per_cell * float(SBL_NEAR_PART) < 1.0; }\n",
"\n",
"// Returns 1 + the number of the leaf at a position on triangle `number` of the scene, or 0 if there is none.\n",
"// back: the back side is seen. distance: distance from which the position is seen.\n",
"int sbl_leaf_at(int number, bool back, vec3 position, float distance) {\n",
"    uint patch_word = sbl_fetch(sbl_store, number >> 2)[number & 3] ^ (back ? SBL_PATCH_BACK : 0u);\n",
"    uvec3 at = uvec3(clamp((position - cell_origin) * per_cell, vec3(0), vec3(SBL_CELL_MOST)));\n",
"    if ((patch_word & SBL_PATCH_FLAT) != 0u) {\n",
"        uint axis = patch_word >> SBL_PATCH_AXIS_SHIFT & 3u;\n",
"        at *= uvec3(axis != 0u, axis != 1u, axis != 2u);\n",
"    }\n",
"    if (sbl_is_near(distance)) patch_word |= SBL_PATCH_NEAR;\n",
"    uint reference = 0u;\n",
"    // Each level has cells for near and for far rays. Those for this distance are tried first.\n",
"    for (int tries = 0; tries < 2 * SBL_LEVELS && reference == 0u; tries++) {\n",
"        uint hash = sbl_hash_step(sbl_hash_step(sbl_hash_step(sbl_hash_step(0u, patch_word), at.x), at.y), at.z);\n",
"        uint check = sbl_hash_step(sbl_hash_step(sbl_hash_step(hash, at.z), at.y), at.x) | 1u;\n",
"        for (int i = 0; i < SBL_SLOT_TRIES; i++) {\n",
"            int place = int(hash + uint(i)) & cell_mask;\n",
"            uvec4 two = sbl_fetch(sbl_store, first_cell + (place >> 1));\n",
"            uvec2 slot = (place & 1) == 0 ? two.xy : two.zw;\n",
"            if (slot.x == check) reference = slot.y;\n",
"            if (slot.x == check || slot.x == 0u) break;\n",
"        }\n",
"        for (int i = 0; i < SBL_CELL_DEPTH && reference >= SBL_CELL_CUT; i++) {\n",
"            int cut = int(reference & ~SBL_CELL_CUT);\n",
"            uvec2 sides = sbl_cut_sides(cut);\n",
"            reference = dot(sbl_cut_normal(cut), position) > sbl_cut_distance(cut) ? sides.y : sides.x;\n",
"        }\n",
"        patch_word ^= SBL_PATCH_NEAR;\n",
"        if ((tries & 1) == 1) {\n",
"            patch_word += SBL_PATCH_LEVEL;\n",
"            at >>= uint(SBL_LEVEL_SHIFT);\n",
"        }\n",
"    }\n",
"    return int(reference);\n",
"}\n",
"\n",
"// R of a leaf. sbl_lamps_of: the part of it that comes directly from lamps. leaf: as sbl_leaf_at returns it\n",
"vec3 sbl_light_of(int leaf) { return leaf == 0 ? vec3(0) : sbl_leaf_light(leaf - 1); }\n",
"\n",
"vec3 sbl_lamps_of(int leaf) {\n",
"    uint rgbe = leaf == 0 ? 0u : sbl_leaf_lamps(leaf - 1);\n",
"    float exponent = float(rgbe >> 24) - float(SBL_RGBE_BIAS + SBL_RGBE_BITS);\n",
"    return vec3(rgbe & 255u, rgbe >> 8 & 255u, rgbe >> 16 & 255u) * exp2(exponent);\n",
"}\n",
"\n",
"// Returns R at a position. The parameters are those of sbl_leaf_at.\n",
"vec3 sbl_stored(int number, bool back, vec3 position, float distance) {\n",
"    return sbl_light_of(sbl_leaf_at(number, back, position, distance));\n",
"}\n",
"#endif\n",
0 };
/* <<glsl */

/* ======================================================================================================== >>scene
   The scene: all rooms above, and what the host draws itself. */

typedef struct sbl__scene {
    sbl__geometry geometry;
    sbl__textures textures;
    sbl__environment environment;
    sbl__lights lights;
    sbl__hierarchy hierarchy;
    sbl__store store;
    sbl_draw_function draw;     /* NULL if the host draws nothing itself */
    void *draw_user;
    float draw_bounds[2][3];
    float draw_brightest;       /* desc.draw_max_radiance, by default 1: limit of the radiance that the host draws */
    int material_count;
    float brightest;            /* upper limit of the radiance of surfaces, the environment, and what the host draws */
    unsigned features;          /* bits: features that programs need for the scene */
    uint32_t version;           /* changes with every change of the scene */
    uint32_t surfaces;          /* version number: every change of the scene gives a new one, except changes of
                                   emission and lights */
} sbl__scene;

#define SBL__RADIANCE_MOST 1e37f /* limit of radiance, so that sums stay finite */

/* Limits of scenes whose light is correct up to rounding errors, measured: the least and the largest diagonal, and the
   largest coordinate in diagonals. */
#define SBL__ACROSS_LEAST 5e-10
#define SBL__ACROSS_MOST 6e9
#define SBL__AWAY_MOST 4e3

static void sbl__scene_free(const sbl__device *d, sbl__scene *s) {
    sbl__store_free(d, &s->store);
    sbl__hierarchy_free(d, &s->hierarchy);
    sbl__lights_free(d, &s->lights);
    sbl__environment_free(d, &s->environment);
    sbl__textures_free(d, &s->textures);
    sbl__geometry_free(d, &s->geometry);
    memset(s, 0, sizeof *s);
}

/* Writes all materials into their meshes' objects; computes s->brightest and s->features. */
static void sbl__scene_dress(sbl__scene *s, const sbl_material *materials) {
    int i;
    s->brightest = SBL__MAX(s->environment.brightest, s->draw ? s->draw_brightest : 0);
    s->features &= ~(unsigned)(SBL__TEXTURED | SBL__CUTOUTS);
    if (s->geometry.colored) s->features |= SBL__TEXTURED;
    for (i = 0; i < s->geometry.mesh_count; i++)
        s->features |= sbl__material_write(&s->textures, &materials[s->geometry.meshes[i].material],
                                           &s->geometry.objects[i], &s->brightest);
}

#define SBL__STORE_LEAVES 49152    /* default limit of the store's leaves, which the interface calls cells */
#define SBL__STORE_TEXELS 8        /* texels that the store's table may need per leaf: the leaf, and its share of all
                                      cells and cuts */

/* Checks s->brightest. Decides whether tables are buffer textures or, if one exceeds the driver's limit for those, 2D
   textures. In buffer textures, lowers the limit of the store's leaves to what they hold. */
static sbl_result sbl__scene_fit(const sbl__device *d, sbl__scene *s) {
    const sbl_capabilities *c = &d->gl.capabilities;
    const sbl__geometry *g = &s->geometry;
    const double lamps = sbl__lamps_most(g, &s->environment, s->lights.count), limit = c->max_texture_buffer_size;
    /* texels of the longest table: 3 per triangle, and a few for grids; 2 per vertex; 5 per mesh; or 9 per lamp, and 3
       more per light of the host */
    const double texels = SBL__MAX(SBL__MAX(3.0 * g->triangle_count + 8, 2.0 * g->vertex_count),
                                   SBL__MAX(5.0 * g->mesh_count, 9 * lamps + 3.0 * s->lights.count));
    double most = c->max_texture_size < SBL__TEXELS_ACROSS ? 0 : (c->max_texture_size - 1) * (double)SBL__TEXELS_ACROSS;
    if (!sbl__between(&s->brightest, 0, SBL__RADIANCE_MOST)) {
        sbl__log(d->base, SBL_LOG_ERROR, SBL_LOG_ITEM_INVALID_MATERIAL, "the brightest emission (times its texture), "
                 "sky or drawn radiance is %g; it must be at most %g", (double)s->brightest,
                 (double)SBL__RADIANCE_MOST);
        return SBL_ERROR_INVALID_ARGUMENT;
    }
    s->geometry.wide = texels > limit;
    if (s->geometry.wide && texels > most) {
        most = SBL__MAX(most, limit);
        sbl__log(d->base, SBL_LOG_ERROR, SBL_LOG_ITEM_TOO_LARGE, "the scene has %d vertices, %d triangles and %d "
                 "meshes; this driver's textures hold %.0f, %.0f and %.0f", g->vertex_count, g->triangle_count,
                 g->mesh_count, most / 2, most / 3, most / 5);
        return SBL_ERROR_UNSUPPORTED;
    }
    if (s->geometry.wide) s->features |= SBL__WIDE;
    else {
        const int leaves = (c->max_texture_buffer_size - g->triangle_count / 4) / SBL__STORE_TEXELS;
        s->store.max_leaves = SBL__MAX(1024, SBL__MIN(s->store.max_leaves, leaves));
    }
    return SBL_SUCCESS;
}

/* Logs warnings about valid scenes that are probably mistakes. */
static void sbl__scene_warn(const sbl__base *base, const sbl__scene *s) {
    const sbl__geometry *g = &s->geometry;
    double shining = s->brightest;
    int i;
    if (!g->triangle_count) return;
    for (i = 0; i < s->lights.count; i++) shining = SBL__MAX(shining, (double)sbl__max3(s->lights.list[i].intensity));
    if (!(shining > 0))
        sbl__log(base, SBL_LOG_WARNING, SBL_LOG_ITEM_NO_LIGHT, "nothing in the scene emits light; give it a sky, "
                 "an environment, lights or a material with emission");
    if (g->across < SBL__ACROSS_LEAST || g->across > SBL__ACROSS_MOST)
        sbl__log(base, SBL_LOG_WARNING, SBL_LOG_ITEM_SCALE, "the scene is %g across; light is correct only from "
                 "%g to %g: scale the scene", g->across, SBL__ACROSS_LEAST, SBL__ACROSS_MOST);
    if (g->away > SBL__AWAY_MOST * g->across)
        sbl__log(base, SBL_LOG_WARNING, SBL_LOG_ITEM_SCALE, "the scene is %g across and reaches %g away from the "
                 "origin, where floats are too coarse; move it to the origin", g->across, g->away);
}

/* Makes everything but the hierarchy, the lamps and the store, which are made when first needed. */
static sbl_result sbl__scene_make(sbl__device *d, sbl__scene *s, const sbl_scene_desc *desc) {
    int i;
    sbl_result result = sbl__check_scene(d, desc);
    if (result != SBL_SUCCESS) return result;
    d->gl.doing = "reading meshes";
    result = sbl__geometry_make(d, &s->geometry, desc);
    if (result == SBL_SUCCESS) result = sbl__textures_make(d, &s->textures, desc);
    d->gl.doing = "storing the environment";
    if (result == SBL_SUCCESS) result = sbl__environment_make(d, &s->environment, desc);
    if (result == SBL_SUCCESS) {
        s->draw = desc->draw;
        s->draw_user = desc->draw_user;
        memcpy(s->draw_bounds, desc->draw_bounds, sizeof s->draw_bounds);
        s->draw_brightest = desc->draw_max_radiance > 0 ? desc->draw_max_radiance : 1.0f;
        s->material_count = desc->material_count;
        s->store.max_leaves = desc->max_bounce_cells ? desc->max_bounce_cells : SBL__STORE_LEAVES;
        for (i = 0; i < desc->mesh_count; i++) {
            const sbl_mesh *mesh = &desc->meshes[i];
            s->geometry.meshes[i].material = mesh->material;
            s->geometry.objects[i].id = mesh->id ? mesh->id : (uint32_t)i + 1;
        }
        sbl__scene_dress(s, desc->materials);
        sbl__geometry_measure(&s->geometry, s->draw ? desc->draw_bounds : NULL);
        result = sbl__lights_make(d->base, &s->lights, desc->lights, desc->light_count, s->brightest,
                                  s->geometry.extent);
    }
    if (result == SBL_SUCCESS) result = sbl__scene_fit(d, s);
    d->gl.doing = "storing meshes";
    if (result == SBL_SUCCESS) result = sbl__geometry_upload(d, &s->geometry);
    if (result != SBL_SUCCESS) sbl__scene_free(d, s);
    return result;
}

/* Marks lamps and store as out of date. They are made again when next needed. */
static void sbl__scene_lamps_changed(const sbl__device *d, sbl__scene *s) {
    sbl__lamps_free(d, s->lights.building);
    s->lights.building = NULL;
    s->lights.ready = s->store.ready = 0;
    s->version++;
}

/* Marks hierarchy, lamps and store as out of date. */
static void sbl__scene_changed(const sbl__device *d, sbl__scene *s) {
    sbl__bvh_free(d, s->hierarchy.building);
    s->hierarchy.building = NULL;
    s->hierarchy.ready = 0;
    s->surfaces++;
    sbl__scene_lamps_changed(d, s);
}

/* Replaces all materials and all lights; NULL keeps them. On failure nothing changes. */
static sbl_result sbl__scene_update_light(sbl__device *d, sbl__scene *s, const sbl_material *materials,
                                     const sbl_light *lights) {
    const size_t count = (size_t)s->geometry.mesh_count;
    sbl__object *objects = (sbl__object *)sbl__alloc_raw(d->base, count, sizeof *objects);
    const sbl__scene before = *s;
    sbl__lights others;
    sbl_result result;
    int i, differ = 0;
    if (!objects) return SBL_ERROR_OUT_OF_MEMORY;
    memset(&others, 0, sizeof others);
    memcpy(objects, before.geometry.objects, count * sizeof *objects);
    s->geometry.objects = objects;
    if (materials) sbl__scene_dress(s, materials);
    result = sbl__lights_make(d->base, &others, lights ? lights : s->lights.list, s->lights.count, s->brightest,
                              s->geometry.extent);
    if (result == SBL_SUCCESS) result = sbl__scene_fit(d, s);
    if (result == SBL_SUCCESS && s->geometry.wide != before.geometry.wide) result = SBL_ERROR_UNSUPPORTED;
    if (result == SBL_SUCCESS) {
        d->gl.doing = "storing materials";
        result = sbl__geometry_attach_objects(d, &s->geometry);
    }
    if (result != SBL_SUCCESS) {
        sbl__lights_free(d, &others);
        sbl__free(d->base, objects);
        *s = before;
        sbl__geometry_attach_objects(d, &s->geometry);
        return result;
    }
    for (i = 0; i < s->geometry.mesh_count; i++)
        differ |= sbl__reflection_differs(&before.geometry.objects[i], &objects[i]);
    sbl__free(d->base, before.geometry.objects);
    sbl__lights_free(d, &s->lights);
    s->lights = others;
    if (differ) sbl__scene_changed(d, s);
    else sbl__scene_lamps_changed(d, s);
    return SBL_SUCCESS;
}

/* Gives a mesh another transform. SBL_ERROR_INVALID_ARGUMENT: nothing has changed. */
static sbl_result sbl__scene_move(sbl__device *d, sbl__scene *s, int mesh, const float transform[16]) {
    float before[16];
    sbl_result result;
    d->gl.doing = "moving a mesh";
    memcpy(before, s->geometry.meshes[mesh].transform, sizeof before);
    result = sbl__geometry_move(d, &s->geometry, mesh, transform);
    if (result == SBL_ERROR_INVALID_ARGUMENT) return result;
    if (result != SBL_SUCCESS) sbl__geometry_move(d, &s->geometry, mesh, before);
    sbl__geometry_measure(&s->geometry, s->draw ? (const float (*)[3])s->draw_bounds : NULL);
    sbl__scene_changed(d, s);
    return result;
}

/* Makes the hierarchy and the lamps, in slices. SBL_SUCCESS: both are ready. */
static sbl_result sbl__scene_step(sbl__device *d, sbl__scene *s, sbl__slice *slice) {
    sbl_result result = sbl__hierarchy_step(d, &s->geometry, &s->hierarchy, slice);
    if (result == SBL_SUCCESS)
        result = sbl__lights_step(d, &s->geometry, &s->hierarchy, &s->environment, &s->lights, slice);
    if (result != SBL_SUCCESS && result != SBL_UNFINISHED) s->hierarchy.ready = 0;
    return result;
}

/* Sets the tables and textures of scene.glsl and surface.glsl. */
static void sbl__scene_bind(sbl__device *d, const sbl__scene *s) {
    sbl__geometry_bind(d, &s->geometry);
    sbl__bind(d, "sbl_texels_srgb", &s->textures.tables[0]);
    sbl__bind(d, "sbl_texels_float", &s->textures.tables[1]);
}

/* >>glsl scene: shaders_embedded/scene.glsl, copied by scripts/embed_shaders */
static const char *const sbl__glsl_scene[] = {
"// The scene's triangles and textures.\n",
"uniform sbl_Texels sbl_indices;      // three vertex numbers per triangle\n",
"uniform sampler2D sbl_texels_srgb;   // texel table of all 8-bit sRGB textures. Texel n of a texture is in column\n",
"                                     // n % width of the table, n / width rows below the texture's first row.\n",
"uniform sampler2D sbl_texels_float;  // texel table, 16-bit floats, of all textures that are not 8-bit sRGB\n",
"\n",
"// Vertex numbers of a triangle of the scene.\n",
"ivec3 sbl_corners(int triangle) {\n",
"    return ivec3(int(sbl_fetch(sbl_indices, 3 * triangle).x), int(sbl_fetch(sbl_indices, 3 * triangle + 1).x),\n",
"                 int(sbl_fetch(sbl_indices, 3 * triangle + 2).x));\n",
"}\n",
"\n",
"struct sbl_Attributes { vec2 uv; vec4 color; };\n",
"\n",
"const sbl_Attributes SBL_PLAIN = sbl_Attributes(vec2(0), vec4(1));  // attributes without any effect\n",
"\n",
"vec4 sbl_unpack_color(uint rg, uint ba) { return vec4(rg & 65535u, rg >> 16, ba & 65535u, ba >> 16); }\n",
"\n",
"vec4 sbl_texel(uvec4 place, ivec2 at) {\n",
"    ivec2 size = ivec2(place.yz);\n",
"    if ((place.w & SBL_TEXTURE_CLAMPS) == 0u) at -= size * ivec2(floor(vec2(at) / vec2(size)));\n",
"    at = clamp(at, ivec2(0), size - 1);  // also for far repeats: the quotient above may be rounded up\n",
"    bool srgb = (place.w & SBL_TEXTURE_KIND) == SBL_TEXTURE_SRGB;\n",
"    int index = at.y * size.x + at.x;\n",
"    int width = srgb ? textureSize(sbl_texels_srgb, 0).x : textureSize(sbl_texels_float, 0).x;\n",
"    ivec2 texel = ivec2(uint(index) % uint(width), place.x + uint(index) / uint(width));\n",
"    return srgb ? texelFetch(sbl_texels_srgb, texel, 0) : texelFetch(sbl_texels_float, texel, 0);\n",
"}\n",
"\n",
"// Reads a texture with bilinear filtering of linear values. place: first row in the texel table, width, height,\n",
"// SBL_TEXTURE flags; all 0: no texture. uv: (0, 0) is the outer corner of the first texel\n",
"vec4 sbl_texture(uvec4 place, vec2 uv) {\n",
"#if defined(SBL_TEXTURED) || defined(SBL_CUTOUTS)\n",
"    if ((place.w & SBL_TEXTURE_CLAMPS) == 0u) uv -= floor(uv);\n",
"    vec2 at = uv * vec2(place.yz) - 0.5, corner = floor(at), f = at - corner;\n",
"    ivec2 c = ivec2(clamp(corner, vec2(-1e9), vec2(1e9)));\n",
"    vec4 sum = vec4(place.w == 0u ? 1 : 0);\n",
"    for (int i = 0; i < (place.w == 0u ? 0 : 4); i++) {\n",
"        ivec2 step = ivec2(i & 1, i >> 1);\n",
"        vec2 weight = mix(1.0 - f, f, vec2(step));\n",
"        sum += weight.x * weight.y * sbl_texel(place, c + step);\n",
"    }\n",
"    return sum;\n",
"#else\n",
"    return vec4(1);\n",
"#endif\n",
"}\n",
0 };
/* <<glsl */

/* >>glsl surface: shaders_embedded/surface.glsl, copied by scripts/embed_shaders */
static const char *const sbl__glsl_surface[] = {
"// Computes surface points from a triangle's number and a ray. Positions that the rasteriser interpolates over a\n",
"// large clipped triangle lie off its plane, so that a sensor there would see its own surface.\n",
"struct sbl_Surface {\n",
"    vec3 position, normal, geometric_normal;  // normals point against the ray\n",
"    sbl_Material material;\n",
"    vec3 emission;\n",
"    float facet;                              // smallest of the triangle's three heights, world units\n",
"    float reach;                              // world distance of the first corner from 0 0 0, plus twice the\n",
"                                              // longest side; rounding errors are in proportion to it\n",
"    uint id;\n",
"    int object;\n",
"    bool back;                                // true: the ray sees the back of the triangle\n",
"};\n",
"\n",
"// Returns the interpolated normal or, if that is too short, `face`, on the side of geometric_normal. A normal that\n",
"// turns away from the viewer would aim the sensor at its own surface, so the cosine is kept above SBL_GRAZING.\n",
"vec3 sbl_shading_normal(ivec3 v, vec3 b, vec3 face, vec3 geometric_normal, vec3 direction) {\n",
"    vec3 normal = b.x * sbl_attributes_normal(v.x) + b.y * sbl_attributes_normal(v.y) +\n",
"                  b.z * sbl_attributes_normal(v.z);\n",
"    float length2 = dot(normal, normal);\n",
"    normal = length2 > SBL_NORMAL_LEAST ? normal * inversesqrt(length2) : face;\n",
"    normal = dot(normal, geometric_normal) < 0.0 ? -normal : normal;\n",
"    float grazing = dot(normal, normalize(direction));\n",
"    if (grazing > -SBL_GRAZING) normal = normalize(normal - (grazing + SBL_GRAZING) * normalize(direction));\n",
"    return normal;\n",
"}\n",
"\n",
"sbl_Attributes sbl_mix_attributes(ivec3 v, vec3 b) {\n",
"    sbl_Attributes at = sbl_Attributes(vec2(0), vec4(0));\n",
"    for (int k = 0; k < 3; k++) {\n",
"        at.uv += b[k] * vec2(sbl_attributes_u(v[k]), sbl_attributes_v(v[k]));\n",
"        at.color += b[k] * sbl_unpack_color(sbl_attributes_color_rg(v[k]), sbl_attributes_color_ba(v[k]));\n",
"    }\n",
"    return sbl_Attributes(at.uv, at.color / SBL_COLOR_MOST);\n",
"}\n",
"\n",
"// A triangle: vertex numbers, first corner, and the edges from there. size: largest component of both edges. s1,\n",
"// s2: edges divided by size, whose cross products do not underflow\n",
"struct sbl_Facet {\n",
"    ivec3 v;\n",
"    vec3 p0, e1, e2, s1, s2;\n",
"    float size;\n",
"};\n",
"\n",
"sbl_Facet sbl_facet(int triangle) {\n",
"    ivec3 v = sbl_corners(triangle);\n",
"    vec3 p0 = sbl_vertex_position(v.x), e1 = sbl_vertex_position(v.y) - p0, e2 = sbl_vertex_position(v.z) - p0;\n",
"    float size = max(max(max(abs(e1.x), abs(e1.y)), abs(e1.z)), max(max(abs(e2.x), abs(e2.y)), abs(e2.z)));\n",
"    return sbl_Facet(v, p0, e1, e2, e1 / size, e2 / size, size);\n",
"}\n",
"\n",
"// The surface point at barycentrics b1, b2 (of the second and third corner), seen along `direction`.\n",
"sbl_Surface sbl_surface_at(sbl_Facet f, float b1, float b2, vec3 direction) {\n",
"    int object = int(sbl_vertex_object(f.v.x));\n",
"    float b0 = 1.0 - b1 - b2;\n",
"\n",
"    sbl_Surface s;\n",
"    s.position = f.p0 + (b1 * f.e1 + b2 * f.e2);\n",
"    vec3 across = cross(f.s1, f.s2), s3 = f.s2 - f.s1;\n",
"    float widest = max(max(abs(across.x), abs(across.y)), abs(across.z));\n",
"    // shorter vectors are scaled first, because their squared length may underflow in normalize\n",
"    vec3 face = normalize(widest > 1e-15 ? across : widest > 0.0 ? across / widest : -direction);\n",
"    float longest = sqrt(max(dot(f.s1, f.s1), max(dot(f.s2, f.s2), dot(s3, s3))));\n",
"    s.facet = f.size * length(across) / longest;\n",
"    s.reach = length(f.p0) + 2.0 * f.size * longest;\n",
"    s.back = dot(face, direction) > 0.0;\n",
"    s.geometric_normal = s.back ? -face : face;\n",
"    s.normal = sbl_shading_normal(f.v, vec3(b0, b1, b2), face, s.geometric_normal, direction);\n",
"\n",
"    sbl_Attributes at = sbl_mix_attributes(f.v, vec3(b0, b1, b2));\n",
"    s.material = sbl_material(object, at);\n",
"    s.emission = sbl_emission(object, s.back) * sbl_emission_pattern(object, at);\n",
"    s.id = sbl_object_id(object);\n",
"    s.object = object;\n",
"    return s;\n",
"}\n",
"\n",
"// The surface point where a ray meets a triangle.\n",
"sbl_Surface sbl_surface(int triangle, vec3 origin, vec3 direction) {\n",
"    sbl_Facet f = sbl_facet(triangle);\n",
"    // Barycentrics by Cramer's rule (Moeller and Trumbore 1997), clamped to the triangle.\n",
"    vec3 t = (origin - f.p0) / f.size, q = cross(t, f.s1), h = cross(direction, f.s2);\n",
"    float determinant = dot(f.s1, h);\n",
"    float b1 = clamp(dot(t, h) / determinant, 0.0, 1.0);\n",
"    float b2 = clamp(dot(direction, q) / determinant, 0.0, 1.0 - b1);\n",
"    if (!(abs(determinant) > 0.0)) { b1 = 1.0 / 3.0; b2 = 1.0 / 3.0; }\n",
"    return sbl_surface_at(f, b1, b2, direction);\n",
"}\n",
"\n",
"#ifdef SBL_LIGHTMAP\n",
"// The surface point seen from the front, which is the side of the vertex normals (see sbl_lightmap_desc).\n",
"sbl_Surface sbl_surface_front(int triangle, float b1, float b2) {\n",
"    sbl_Facet f = sbl_facet(triangle);\n",
"    vec3 face = normalize(cross(f.s1, f.s2));\n",
"    vec3 normal = (1.0 - b1 - b2) * sbl_attributes_normal(f.v.x) + b1 * sbl_attributes_normal(f.v.y) +\n",
"                  b2 * sbl_attributes_normal(f.v.z);\n",
"    return sbl_surface_at(f, b1, b2, dot(normal, face) < 0.0 ? face : -face);\n",
"}\n",
"#endif\n",
0 };
/* <<glsl */

/* ====================================================================================================== >>options
   The options that all front ends share, and the descriptor of each front end, with defaults and checks side by side.
   In functions that check a descriptor, d has its defaults filled in. */

/* Returns the preset as an index. A number out of range, which the checks refuse later, counts as the default. */
static int sbl__preset_of(const sbl_options *o) {
    return (int)o->preset >= 0 && o->preset < SBL_PRESET_COUNT ? (int)o->preset : SBL_PRESET_DEFAULT;
}

/* Fills in the defaults of the options. rays, sizes: default of o->rays and of o->sensor_size for each preset. If rays
   is NULL, o->rays stays 0, and the target error decides how many rays are traced */
static void sbl__options_defaults(sbl_options *o, const int rays[SBL_PRESET_COUNT], const int sizes[SBL_PRESET_COUNT]) {
    const int preset = sbl__preset_of(o);
    if (o->mode == SBL_MODE_DEFAULT) o->mode = SBL_MODE_GI;
    if (!o->rays && rays) o->rays = rays[preset];
    if (!o->sensor_size) o->sensor_size = sizes[preset];
    if (o->mode == SBL_MODE_DIRECT || o->mode == SBL_MODE_GI) o->epsilon = 0;
    else if (sbl__zero(&o->epsilon)) o->epsilon = 0.02f;
}

static const int sbl__sensor_sizes[SBL_PRESET_COUNT] = { 64, 32, 128 };

/* papers: 1 allows SBL_MODE_PAPER. rays: range of options.rays. host_draws: 1 if the scene has a draw callback */
static void sbl__check_options(sbl__check *check, const sbl_options *o, int papers, const int rays[2], int host_draws) {
    sbl__check_int(check, "options.mode", (int)o->mode, 0, SBL_MODE_COUNT - 1);
    if (o->mode == SBL_MODE_PAPER && !papers)
        sbl__mistake(check, "options.mode is SBL_MODE_PAPER; only pictures and readings have it");
    sbl__check_int(check, "options.preset", (int)o->preset, 0, SBL_PRESET_COUNT - 1);
    sbl__check_int(check, "options.backend", (int)o->backend, 0, SBL_BACKEND_COUNT - 1);
    if (o->backend == SBL_BACKEND_TRACE && (o->mode == SBL_MODE_PAPER || host_draws))
        sbl__mistake(check, "options.backend is SBL_BACKEND_TRACE %s; use SBL_BACKEND_AUTO or SBL_BACKEND_RASTER",
                     host_draws ? "in a scene with a draw callback" : "in SBL_MODE_PAPER");
    if (o->rays) sbl__check_int(check, "options.rays", o->rays, rays[0], rays[1]);
    sbl__check_int(check, "options.sensor_size", o->sensor_size, 4, 512);
    sbl__check_finite(check, "options.epsilon", &o->epsilon, 1);
}

static const int sbl__sensor_rays[2] = { 1, 4096 };  /* lowest and highest number of rays of a sensor */

static void sbl__sensor_defaults(sbl_mode mode, sbl_sensor_kind *kind, float *fov) {
    if (*kind == SBL_SENSOR_DEFAULT) *kind = mode == SBL_MODE_PAPER ? SBL_SENSOR_SINGLE : SBL_SENSOR_HEMICUBE;
    if (sbl__zero(fov)) *fov = 135;
}

static void sbl__check_sensor_kind(sbl__check *check, const sbl_options *o, sbl_sensor_kind kind, float fov) {
    sbl__check_int(check, "sensor_kind", (int)kind, 0, SBL_SENSOR_KIND_COUNT - 1);
    if (o->mode == SBL_MODE_PAPER && kind == SBL_SENSOR_HEMICUBE)
        sbl__mistake(check, "sensor_kind is SBL_SENSOR_HEMICUBE in SBL_MODE_PAPER; the paper's sensor is "
                     "SBL_SENSOR_SINGLE");
    if (o->backend == SBL_BACKEND_TRACE && kind == SBL_SENSOR_SINGLE && o->mode != SBL_MODE_PAPER)
        sbl__mistake(check, "options.backend is SBL_BACKEND_TRACE with SBL_SENSOR_SINGLE; use SBL_BACKEND_AUTO or "
                     "SBL_BACKEND_RASTER");
    if (!sbl__between(&fov, 1, 179)) sbl__mistake(check, "sensor_fov is %g; it must be 1 to 179 degrees", (double)fov);
}

/* What the host requests of a front end's sensors. */
typedef struct sbl__measurement {
    sbl_options options;       /* with defaults; a negative epsilon is 0. sbl__begin replaces SBL_BACKEND_AUTO */
    sbl_sensor_kind sensor_kind;
    float sensor_fov;
    int look_rays, looks;      /* number of rays per look, and maximum number of looks; used if options.rays is 0 */
    int every_ray;             /* 0: trace at most SBL__TRACE_CHUNK rays where all light comes from lamps, so that
                                  they only measure distances. 1: trace all rays nevertheless */
} sbl__measurement;

/* Returns the measurement that options, with defaults, request. The fields from look_rays on are 0. */
static sbl__measurement sbl__measurement_of(const sbl_options *o, sbl_sensor_kind kind, float fov) {
    sbl__measurement m;
    memset(&m, 0, sizeof m);
    m.options = *o;
    m.options.epsilon = SBL__MAX(o->epsilon, 0.0f);
    m.sensor_kind = kind;
    m.sensor_fov = fov;
    return m;
}

static int sbl__rigid(const float m[16]) {
    int i, k;
    for (i = 0; i < 3; i++)
        for (k = 0; k < 3; k++)
            if (fabs((double)m[i] * m[k] + (double)m[4 + i] * m[4 + k] + (double)m[8 + i] * m[8 + k] - (i == k)) > 1e-3)
                return 0;
    return sbl__affine_determinant(m) > 0;
}

static void sbl__check_camera(sbl__check *check, const sbl_picture_desc *d) {
    const float *v = d->world_to_view, *m = d->view_to_clip;
    int perspective, orthographic;
    sbl__check_finite(check, "world_to_view", v, 16);
    if (sbl__all_finite(v, 16) && !sbl__rigid(v))
        sbl__mistake(check, "world_to_view is not rigid (a rotation and a translation, column-major); sbl_look_at "
                     "makes one");
    sbl__check_finite(check, "view_to_clip", m, 16);
    if (!sbl__all_finite(m, 16) || d->width <= 0 || d->height <= 0) return;  /* there is no default projection */
    perspective = m[3] == 0.0f && m[7] == 0.0f && m[11] < 0.0f && m[15] == 0.0f && m[12] == 0.0f && m[13] == 0.0f;
    orthographic = m[3] == 0.0f && m[7] == 0.0f && m[11] == 0.0f && m[15] == 1.0f && m[8] == 0.0f && m[9] == 0.0f;
    if (!(perspective || orthographic) || m[0] == 0.0f || m[5] == 0.0f || m[1] != 0.0f || m[4] != 0.0f)
        sbl__mistake(check, "view_to_clip is neither a perspective nor an orthographic projection (column-major, view "
                     "direction -z; its last row is %g %g %g %g); sbl_perspective makes one", (double)m[3],
                     (double)m[7], (double)m[11], (double)m[15]);
}

/* >>options: pictures */

SBL_API sbl_picture_desc sbl_picture_desc_defaults(const sbl_picture_desc *desc) {
    static const float errors[SBL_PRESET_COUNT] = { 0.015f, 0.05f, 0.0075f };
    static const int samples[SBL_PRESET_COUNT] = { 4, 1, 16 };
    sbl_picture_desc d;
    if (desc) d = *desc;
    else memset(&d, 0, sizeof d);
    sbl__options_defaults(&d.options, NULL, sbl__sensor_sizes);
    sbl__sensor_defaults(d.options.mode, &d.sensor_kind, &d.sensor_fov);
    if (!d.width && !d.height) { d.width = 640; d.height = 480; }
    if (d.width > 0 && d.height > 0 && sbl__all_zero(d.view_to_clip, 16))
        sbl_perspective(d.view_to_clip, 40, (float)d.width / (float)d.height);
    if (sbl__zero(&d.target_error) && d.options.mode != SBL_MODE_PAPER)
        d.target_error = errors[sbl__preset_of(&d.options)];
    if (!d.tile) d.tile = 16;
    if (sbl__zero(&d.threshold) && d.options.mode == SBL_MODE_PAPER) d.threshold = 0.05f;
    if (sbl__zero(&d.facet_limit)) d.facet_limit = 2;
    if (!d.filter_radius) d.filter_radius = 2;
    if (!d.samples) d.samples = samples[sbl__preset_of(&d.options)];
    return d;
}

/* Checks the fields that pictures and lightmaps share. */
static void sbl__check_refinement(sbl__check *check, const sbl_picture_desc *d) {
    sbl__check_int(check, "width", d->width, 1, 16384);
    sbl__check_int(check, "height", d->height, 1, 16384);
    sbl__check_int(check, "tile", d->tile, 1, 1024);
    sbl__check_range(check, "target_error", &d->target_error, 1, sbl__unit_range);
    sbl__check_finite(check, "threshold", &d->threshold, 1);
    if (d->filter_radius > 32) sbl__mistake(check, "filter_radius is %d; it must be at most 32", d->filter_radius);
}

static sbl_result sbl__check_picture(const sbl__base *base, const sbl_picture_desc *d, int host_draws) {
    static const float stops[2] = { -100, 100 };
    sbl__check check = { base, NULL, SBL_LOG_ITEM_INVALID_PICTURE_DESC, "sbl_picture_desc", 0 };
    if (!sbl__check_canaries(&check, d->start_canary, d->end_canary)) return sbl__check_end(&check);
    sbl__check_options(&check, &d->options, 1, sbl__sensor_rays, host_draws);
    sbl__check_sensor_kind(&check, &d->options, d->sensor_kind, d->sensor_fov);
    sbl__check_refinement(&check, d);
    sbl__check_finite(&check, "facet_limit", &d->facet_limit, 1);
    sbl__check_int(&check, "samples", d->samples, 1, 64);
    sbl__check_int(&check, "tone", (int)d->tone, 0, SBL_TONE_COUNT - 1);
    sbl__check_range(&check, "exposure", &d->exposure, 1, stops);
    sbl__check_int(&check, "auto_exposure", d->auto_exposure, 0, 1);
    sbl__check_camera(&check, d);
    return sbl__check_end(&check);
}

/* >>options: lightmaps */

/* Returns 1 if supersample is valid and the supersampled width and height are at most 16384. */
static int sbl__supersample_fits(const sbl_lightmap_desc *d) {
    const int most = 16384;
    return d->supersample >= 1 && d->supersample <= 8 && d->width >= 1 && d->height >= 1 &&
           d->width <= most / d->supersample && d->height <= most / d->supersample;
}

/* Returns the picture whose refinement a lightmap uses. Its width and height are multiplied by supersample. */
static sbl_picture_desc sbl__lightmap_picture(const sbl_lightmap_desc *d) {
    const int across = sbl__supersample_fits(d) ? d->supersample : 1;
    sbl_picture_desc picture;
    memset(&picture, 0, sizeof picture);
    picture.options = d->options;
    picture.width = d->width * across;
    picture.height = d->height * across;
    picture.target_error = d->target_error;
    picture.tile = d->tile;
    picture.threshold = d->threshold;
    picture.filter_radius = d->filter_radius;
    picture.samples = 1;
    sbl__identity(picture.world_to_view);
    return sbl_picture_desc_defaults(&picture);
}

SBL_API sbl_lightmap_desc sbl_lightmap_desc_defaults(const sbl_lightmap_desc *desc) {
    static const float errors[SBL_PRESET_COUNT] = { 0.005f, 0.02f, 0.0025f };
    sbl_lightmap_desc d;
    sbl_picture_desc picture;
    if (desc) d = *desc;
    else memset(&d, 0, sizeof d);
    if (!d.width && !d.height) d.width = d.height = 512;
    if (!d.gutter) d.gutter = 16;
    if (!d.supersample) d.supersample = 1;
    if (sbl__zero(&d.target_error)) d.target_error = errors[sbl__preset_of(&d.options)];
    picture = sbl__lightmap_picture(&d);
    d.options = picture.options;
    d.tile = picture.tile;
    d.filter_radius = picture.filter_radius;
    return d;
}

static sbl_result sbl__check_lightmap(const sbl__base *base, const sbl_lightmap_desc *d, const sbl__scene *scene) {
    const sbl_picture_desc picture = sbl__lightmap_picture(d);
    const sbl__geometry *g = &scene->geometry;
    sbl__check check = { base, NULL, SBL_LOG_ITEM_INVALID_LIGHTMAP_DESC, "sbl_lightmap_desc", 0 };
    int i;
    if (!sbl__check_canaries(&check, d->start_canary, d->end_canary)) return sbl__check_end(&check);
    sbl__check_options(&check, &d->options, 0, sbl__sensor_rays, scene->draw != NULL);
    sbl__check_refinement(&check, &picture);
    sbl__check_int(&check, "gutter", d->gutter, -INT_MAX, 16384);
    sbl__check_int(&check, "directional", d->directional, 0, 1);
    sbl__check_int(&check, "supersample", d->supersample, 1, 8);
    if (d->supersample > 1 && d->supersample <= 8 && !sbl__supersample_fits(d))
        sbl__mistake(&check, "supersample is %d; times the size, %d x %d, it must be at most 16384", d->supersample,
                     d->width, d->height);
    sbl__check_array(&check, "mesh_count", d->mesh_count, d->meshes);
    for (i = 0; d->meshes && i < d->mesh_count; i++) {
        const int mesh = d->meshes[i];
        if (mesh < 0 || mesh >= g->mesh_count)
            sbl__mistake(&check, "meshes[%d] is %d; the scene has %d", i, mesh, g->mesh_count);
        else if (!g->meshes[mesh].lightmapped)
            sbl__mistake(&check, "meshes[%d] is %d, a mesh without lightmap_texcoords", i, mesh);
    }
    return sbl__check_end(&check);
}

/* >>options: readings */

SBL_API sbl_readings_desc sbl_readings_desc_defaults(const sbl_readings_desc *desc) {
    static const int rays[SBL_PRESET_COUNT] = { 256, 64, 1024 };
    sbl_readings_desc d;
    if (desc) d = *desc;
    else memset(&d, 0, sizeof d);
    sbl__options_defaults(&d.options, rays, sbl__sensor_sizes);
    sbl__sensor_defaults(d.options.mode, &d.sensor_kind, &d.sensor_fov);
    return d;
}

#define SBL__SITES_NAMED 16  /* number of wrong sites that are named; the others are only counted */

/* Reports how many things in a list are wrong besides the SBL__SITES_NAMED that were named, if any. where: name of the
   descriptor; wrong: number of all wrong things */
static void sbl__check_rest(sbl__check *check, const char *where, const char *things, int wrong) {
    snprintf(check->where, sizeof check->where, "%s", where);
    if (wrong > SBL__SITES_NAMED) sbl__mistake(check, "%d more %s are wrong", wrong - SBL__SITES_NAMED, things);
}

/* Returns 1 if the site is valid. Otherwise reports its mistakes if `named` is 1. */
static int sbl__check_site(sbl__check *check, const sbl_site *s, int number, int named) {
    const int good = sbl__all_finite(s->position, 3) && sbl__all_finite(s->normal, 3) &&
                     !sbl__all_zero(s->normal, 3) && sbl__all_finite(s->geometric_normal, 3) &&
                     sbl__finite(&s->offset);
    if (good || !named) return good;
    sbl__check_object(check, check->item, "site", number);
    sbl__check_finite(check, "position", s->position, 3);
    sbl__check_finite(check, "normal", s->normal, 3);
    if (sbl__all_zero(s->normal, 3))
        sbl__mistake(check, "normal is 0 0 0; it must point to the side that the light comes from");
    sbl__check_finite(check, "geometric_normal", s->geometric_normal, 3);
    sbl__check_finite(check, "offset", &s->offset, 1);
    return 0;
}

static sbl_result sbl__check_readings(const sbl__base *base, const sbl_readings_desc *d, int host_draws) {
    sbl__check check = { base, NULL, SBL_LOG_ITEM_INVALID_READINGS_DESC, "sbl_readings_desc", 0 };
    int i, wrong = 0;
    if (!sbl__check_canaries(&check, d->start_canary, d->end_canary)) return sbl__check_end(&check);
    sbl__check_options(&check, &d->options, 1, sbl__sensor_rays, host_draws);
    sbl__check_sensor_kind(&check, &d->options, d->sensor_kind, d->sensor_fov);
    sbl__check_array(&check, "site_count", d->site_count, d->sites);
    if (!d->readings && d->site_count > 0) sbl__mistake(&check, "readings is NULL; it receives site_count readings");
    for (i = 0; d->sites && i < d->site_count; i++)
        wrong += !sbl__check_site(&check, &d->sites[i], i, wrong < SBL__SITES_NAMED);
    sbl__check_rest(&check, "sbl_readings_desc", "sites", wrong);
    return sbl__check_end(&check);
}

/* >>options: light at vertices */

SBL_API sbl_vertices_desc sbl_vertices_desc_defaults(const sbl_vertices_desc *desc) {
    static const int rays[SBL_PRESET_COUNT] = { 64, 16, 256 }, samples[SBL_PRESET_COUNT] = { 8, 4, 16 };
    sbl_vertices_desc d;
    if (desc) d = *desc;
    else memset(&d, 0, sizeof d);
    sbl__options_defaults(&d.options, rays, sbl__sensor_sizes);
    if (!d.samples) d.samples = samples[sbl__preset_of(&d.options)];
    if (sbl__zero(&d.smoothing)) d.smoothing = 0.02f;
    return d;
}

#define SBL__VERTICES_SMOOTHEST 1e6f

static sbl_result sbl__check_vertices(const sbl__base *base, const sbl_vertices_desc *d, const sbl__scene *scene) {
    const sbl__geometry *g = &scene->geometry;
    double vertices = 0, triangles = 0;
    sbl__check check = { base, NULL, SBL_LOG_ITEM_INVALID_VERTICES_DESC, "sbl_vertices_desc", 0 };
    int i;
    if (!sbl__check_canaries(&check, d->start_canary, d->end_canary)) return sbl__check_end(&check);
    sbl__check_options(&check, &d->options, 0, sbl__sensor_rays, scene->draw != NULL);
    sbl__check_int(&check, "samples", d->samples, 1, 1024);
    sbl__check_int(&check, "average", d->average, 0, 1);
    if (!sbl__between(&d->smoothing, -FLT_MAX, SBL__VERTICES_SMOOTHEST))
        sbl__mistake(&check, "smoothing is %g; it must be finite and at most %g", (double)d->smoothing,
                     (double)SBL__VERTICES_SMOOTHEST);
    sbl__check_array(&check, "mesh_count", d->mesh_count, d->meshes);
    for (i = 0; i < (d->mesh_count ? d->mesh_count : g->mesh_count) && (d->meshes || !d->mesh_count); i++) {
        const int mesh = d->mesh_count ? d->meshes[i] : i;
        if (mesh >= 0 && mesh < g->mesh_count) {
            vertices += g->meshes[mesh].vertex_count;
            triangles += g->meshes[mesh].triangle_count;
        } else
            sbl__mistake(&check, "meshes[%d] is %d; the scene has %d", i, mesh, g->mesh_count);
    }
    if (vertices > INT_MAX / 4 || triangles > INT_MAX / 4)
        sbl__mistake(&check, "meshes have %.0f vertices and %.0f triangles; at most %d of each can be numbered",
                     vertices, triangles, INT_MAX / 4);
    if (vertices > 0 && !d->radiance)
        sbl__mistake(&check, "radiance is NULL; it receives 3 floats for each of %.0f vertices", vertices);
    if ((double)d->float_count < 3 * vertices)
        sbl__mistake(&check, "float_count is %.0f; %.0f vertices need %.0f floats", (double)d->float_count, vertices,
                     3 * vertices);
    return sbl__check_end(&check);
}

/* >>options: probes */

/* Returns the number of points of a grid: 0 if there is no grid, INT_MAX if there are too many points. */
static int sbl__grid_count(const int grid[3]) {
    double count = 1;
    int k;
    for (k = 0; k < 3; k++) count *= grid[k];
    return grid[0] < 1 || grid[1] < 1 || grid[2] < 1 ? 0 : (int)SBL__MIN(count, (double)INT_MAX);
}

static void sbl__check_grid(sbl__check *check, const sbl_probes_desc *d) {
    const int given = d->grid[0] || d->grid[1] || d->grid[2], points = sbl__grid_count(d->grid);
    int k;
    if (!given && d->probe_count > 0)
        sbl__mistake(check, "probe_count is %d; positions is NULL, and there is no grid", d->probe_count);
    for (k = 0; k < 3 && given; k++) {
        char name[16];
        snprintf(name, sizeof name, "grid[%d]", k);
        sbl__check_int(check, name, d->grid[k], 1, 16384);
    }
    if (points == INT_MAX) sbl__mistake(check, "grid has more points than an int can count");
    else if (points && d->probe_count != points && d->probe_count >= 0)
        sbl__mistake(check, "probe_count is %d; the grid has %d points", d->probe_count, points);
    sbl__check_finite(check, "lowest", d->lowest, 3);
    sbl__check_finite(check, "highest", d->highest, 3);
    for (k = 0; k < 3 && sbl__all_finite(d->lowest, 3) && sbl__all_finite(d->highest, 3); k++)
        if (d->lowest[k] > d->highest[k])
            sbl__mistake(check, "lowest[%d] is %g; highest[%d], %g, is less", k, (double)d->lowest[k], k,
                         (double)d->highest[k]);
}

SBL_API sbl_probes_desc sbl_probes_desc_defaults(const sbl_probes_desc *desc) {
    static const int rays[SBL_PRESET_COUNT] = { 4096, 1024, 16384 }, sizes[SBL_PRESET_COUNT] = { 16, 8, 32 };
    sbl_probes_desc d;
    if (desc) d = *desc;
    else memset(&d, 0, sizeof d);
    sbl__options_defaults(&d.options, rays, sizes);
    if (!d.positions && !d.probe_count) d.probe_count = sbl__grid_count(d.grid);
    return d;
}

static sbl_result sbl__check_probes(const sbl__base *base, const sbl_probes_desc *d, int host_draws) {
    static const int rays[2] = { 64, 65536 };
    sbl__check check = { base, NULL, SBL_LOG_ITEM_INVALID_PROBES_DESC, "sbl_probes_desc", 0 };
    int i, wrong = 0;
    if (!sbl__check_canaries(&check, d->start_canary, d->end_canary)) return sbl__check_end(&check);
    sbl__check_options(&check, &d->options, 0, rays, host_draws);
    sbl__check_range(&check, "move", &d->move, 1, sbl__not_negative_range);
    if (d->probe_count < 0) sbl__mistake(&check, "probe_count is %d; it cannot be negative", d->probe_count);
    if (!d->probes && d->probe_count > 0) sbl__mistake(&check, "probes is NULL; it receives probe_count probes");
    if (!d->positions) sbl__check_grid(&check, d);
    for (i = 0; d->positions && i < d->probe_count; i++) {
        const float *position = d->positions + 3 * (size_t)i;
        if (sbl__all_finite(position, 3) || wrong++ >= SBL__SITES_NAMED) continue;
        sbl__check_object(&check, check.item, "probe", i);
        sbl__check_finite(&check, "position", position, 3);
    }
    sbl__check_rest(&check, "sbl_probes_desc", "probes", wrong);
    return sbl__check_end(&check);
}

/* ======================================================================================================== >>atlas
   Finds, on the CPU, which point of which triangle each texel of a lightmap shows. A triangle claims every texel whose
   square it touches, and offers its point nearest to the texel's centre. The texel shows the nearest point offered; if
   several are equally near, that of the first triangle. Triangles that share a corner, with the same position and the
   same lightmap coordinates, belong to one chart. */

/* Words of a texel in sbl__atlas.texels: 1 + triangle number (0: none), barycentric weights of corners 1 and 2 as
   floats, 1 + chart number. */
#define SBL__ATLAS_WORDS 4
#define SBL__ATLAS_FAR 1e30f    /* squared distance that counts for a texel that shows no triangle yet */
#define SBL__ATLAS_WELL -1.0f   /* not a distance: the texel's centre lies well inside the triangle */
#define SBL__ATLAS_EDGE -0.5f   /* not a distance: it lies inside, near an edge; a neighbour may contain it too */
#define SBL__ATLAS_INSIDE 1e-3  /* a centre lies well inside if all its barycentric weights are at least this */
/* If a texel's centre is not well inside its triangle, the texel's sensor is moved towards the triangle's centroid by
   SBL__ATLAS_INSET texels, but at most by the share SBL__ATLAS_INSET_MOST of the way. Otherwise a sensor at the edge of
   a wall would stand inside the adjoining wall. */
#define SBL__ATLAS_INSET 0.02
#define SBL__ATLAS_INSET_MOST 0.01

typedef struct sbl__atlas {
    sbl__stages stages;
    sbl__base *base;
    const sbl__geometry *geometry;
    int width, height;          /* size of the map in supersampled texels, which this room calls texels */
    int across;                 /* number of supersampled texels across a texel of the lightmap */
    unsigned char *baked;       /* per mesh: 1 if the lightmap contains it */
    int row;                    /* next row of the map to fill for the triangle in progress; 0: not begun */
    uint32_t *parents;          /* per vertex: union-find over charts (see sbl__root); later the chart's number */
    sbl__hash_table places;     /* vertices by position and lightmap coordinates */
    uint32_t *texels;           /* see SBL__ATLAS_WORDS */
    float *away;                /* per texel: squared distance in texels from its centre to the point that it shows. If
                                   its triangle contains the centre: SBL__ATLAS_WELL or SBL__ATLAS_EDGE, minus the
                                   number of other triangles that contain it */
    int charts;                 /* number of charts */
    double world_area, area;    /* total area of the triangles, in world space and in square texels */
    int overlapping, outside;   /* numbers of texels where triangles overlap, and of triangles partly off the map */
} sbl__atlas;

static void sbl__atlas_free(sbl__base *base, sbl__atlas *a) {
    sbl__free(base, a->baked);
    sbl__free(base, a->parents);
    sbl__hash_table_free(base, &a->places);
    sbl__free(base, a->texels);
    sbl__free(base, a->away);
    memset(a, 0, sizeof *a);
}

/* Allocates an atlas for a checked descriptor. If it lists no meshes, all lightmapped meshes are baked. */
static sbl_result sbl__atlas_begin(sbl__base *base, sbl__atlas *a, const sbl__geometry *g,
                                   const sbl_lightmap_desc *desc) {
    size_t texels;
    int i;
    a->across = desc->supersample;
    a->width = desc->width * a->across;
    a->height = desc->height * a->across;
    texels = (size_t)a->width * (size_t)a->height;
    a->base = base;
    a->geometry = g;
    a->baked = (unsigned char *)sbl__alloc(base, (size_t)g->mesh_count, 1);
    a->parents = (uint32_t *)sbl__alloc_raw(base, (size_t)g->vertex_count, sizeof *a->parents);
    a->texels = (uint32_t *)sbl__alloc(base, texels, SBL__ATLAS_WORDS * sizeof *a->texels);
    a->away = (float *)sbl__alloc(base, texels, sizeof *a->away);
    if (!a->baked || !a->parents || !a->texels || !a->away) return SBL_ERROR_OUT_OF_MEMORY;
    for (i = 0; i < desc->mesh_count; i++) a->baked[desc->meshes[i]] = 1;
    for (i = 0; i < g->mesh_count && !desc->mesh_count; i++) a->baked[i] = g->meshes[i].lightmapped != 0;
    return sbl__hash_table_make(base, &a->places, g->vertex_count);
}

static int sbl__atlas_is_baked(const sbl__atlas *a, uint32_t vertex) {
    return a->baked[a->geometry->vertices[vertex].object];
}

/* >>atlas: charts */

static const float *sbl__atlas_uv(const sbl__geometry *g, uint32_t vertex) {
    return g->lightmap_texcoords + 2 * (size_t)vertex;
}

static int sbl__atlas_same(const void *geometry, uint32_t one, uint32_t other) {
    const sbl__geometry *g = (const sbl__geometry *)geometry;
    return sbl__same_place(g, one, other) && sbl__same_floats(sbl__atlas_uv(g, one), sbl__atlas_uv(g, other), 2);
}

/* Joins a vertex with the first one that has the same position and the same lightmap coordinates. */
static sbl_result sbl__atlas_weld(void *work, int vertex) {
    sbl__atlas *a = (sbl__atlas *)work;
    const sbl__geometry *g = a->geometry;
    const uint32_t at = (uint32_t)vertex;
    uint32_t hash;
    a->parents[at] = at;
    if (!sbl__atlas_is_baked(a, at)) return SBL_SUCCESS;
    hash = sbl__hash_floats(sbl__place_hash(g, at), sbl__atlas_uv(g, at), 2);
    sbl__join(a->parents, at, sbl__hash_table_first(&a->places, hash, at, sbl__atlas_same, g));
    return SBL_SUCCESS;
}

static sbl_result sbl__atlas_join(void *work, int triangle) {
    sbl__atlas *a = (sbl__atlas *)work;
    const uint32_t *corners = a->geometry->indices + 3 * (size_t)triangle;
    int i;
    for (i = 1; i < 3 && sbl__atlas_is_baked(a, corners[0]); i++) sbl__join(a->parents, corners[0], corners[i]);
    return SBL_SUCCESS;
}

/* Replaces a vertex's parent by the number of its chart. The root of a chart is its first vertex, so the root gets its
   number before the chart's other vertices need it. */
static sbl_result sbl__atlas_number(void *work, int vertex) {
    sbl__atlas *a = (sbl__atlas *)work;
    uint32_t *parent = &a->parents[vertex];
    if (!sbl__atlas_is_baked(a, (uint32_t)vertex)) return SBL_SUCCESS;
    *parent = *parent == (uint32_t)vertex ? (uint32_t)a->charts++ : a->parents[*parent];
    return SBL_SUCCESS;
}

/* >>atlas: texels */

typedef struct sbl__atlas_triangle {
    double corners[3][2];  /* positions in the atlas, texels */
    double area;           /* twice the signed area, square texels */
    uint32_t number, chart;
    int rows[2];           /* first and last row that the triangle touches */
} sbl__atlas_triangle;

/* Gets the first and last of `size` texels that an interval touches. If it touches none or low > high, last < first. */
static void sbl__atlas_span(double low, double high, int size, int out[2]) {
    const double first = floor(low), last = SBL__MAX(first, ceil(high) - 1);
    out[0] = first >= size ? size : first < 0 ? 0 : (int)first;
    out[1] = last >= size ? size - 1 : last < 0 ? -1 : (int)last;
}

/* Extends the interval from .. to so that it contains x. */
static void sbl__extend(double *from, double *to, double x) {
    *from = SBL__MIN(*from, x);
    *to = SBL__MAX(*to, x);
}

static void sbl__atlas_load(const sbl__atlas *a, uint32_t number, sbl__atlas_triangle *t) {
    const sbl__geometry *g = a->geometry;
    const int size[2] = { a->width, a->height };
    double low = DBL_MAX, high = -DBL_MAX;
    int i, k;
    for (i = 0; i < 3; i++) {
        const float *uv = sbl__atlas_uv(g, g->indices[3 * (size_t)number + (size_t)i]);
        for (k = 0; k < 2; k++) t->corners[i][k] = (double)uv[k] * size[k];
        sbl__extend(&low, &high, t->corners[i][1]);
    }
    t->area = (t->corners[1][0] - t->corners[0][0]) * (t->corners[2][1] - t->corners[0][1]) -
              (t->corners[2][0] - t->corners[0][0]) * (t->corners[1][1] - t->corners[0][1]);
    t->number = number;
    t->chart = a->parents[g->indices[3 * (size_t)number]];
    sbl__atlas_span(low, high, a->height, t->rows);
}

/* Gets the first and last column that a triangle touches in a row. */
static void sbl__atlas_columns(const sbl__atlas *a, const sbl__atlas_triangle *t, int row, int columns[2]) {
    double low = DBL_MAX, high = -DBL_MAX;
    int i, side;
    for (i = 0; i < 3; i++) {
        const double *p = t->corners[i], *q = t->corners[(i + 1) % 3];
        if (p[1] >= row && p[1] <= row + 1) sbl__extend(&low, &high, p[0]);
        for (side = row; side <= row + 1; side++)
            if ((p[1] < side) != (q[1] < side))
                sbl__extend(&low, &high, p[0] + (side - p[1]) / (q[1] - p[1]) * (q[0] - p[0]));
    }
    sbl__atlas_span(low, high, a->width, columns);
}

/* Gets the point of a triangle nearest to a texel's centre, as barycentric weights. Returns the squared distance in
   texels, or SBL__ATLAS_WELL or SBL__ATLAS_EDGE if the triangle contains the centre. */
static double sbl__atlas_nearest(const sbl__atlas_triangle *t, const double centre[2], double weights[3]) {
    double least = DBL_MAX;
    int i, k, inside = t->area != 0, well = 1;
    for (i = 0; i < 3 && inside; i++) {
        const double *p = t->corners[(i + 1) % 3], *q = t->corners[(i + 2) % 3];
        weights[i] = ((p[0] - centre[0]) * (q[1] - centre[1]) - (q[0] - centre[0]) * (p[1] - centre[1])) / t->area;
        if (!(weights[i] >= 0)) inside = 0;
        if (weights[i] < SBL__ATLAS_INSIDE) well = 0;
    }
    if (inside) return (double)(well ? SBL__ATLAS_WELL : SBL__ATLAS_EDGE);
    for (i = 0; i < 3; i++) {
        const double *p = t->corners[i], *q = t->corners[(i + 1) % 3];
        double along = 0, length2 = 0, distance2 = 0;
        for (k = 0; k < 2; k++) {
            along += (centre[k] - p[k]) * (q[k] - p[k]);
            length2 += (q[k] - p[k]) * (q[k] - p[k]);
        }
        along = length2 > 0 ? SBL__MIN(SBL__MAX(along / length2, 0.0), 1.0) : 0;
        for (k = 0; k < 2; k++) {
            const double d = p[k] + along * (q[k] - p[k]) - centre[k];
            distance2 += d * d;
        }
        if (!(distance2 < least)) continue;
        least = distance2;
        weights[i] = 1 - along;
        weights[(i + 1) % 3] = along;
        weights[(i + 2) % 3] = 0;
    }
    return least;
}

/* Moves a point on or near a triangle's edge towards the centroid, see SBL__ATLAS_INSET. */
static void sbl__atlas_inset(const sbl__atlas_triangle *t, double weights[3]) {
    double distance2 = 0, share;
    int i, k;
    for (k = 0; k < 2; k++) {
        double d = 0;
        for (i = 0; i < 3; i++) d += (1 / 3.0 - weights[i]) * t->corners[i][k];
        distance2 += d * d;
    }
    share = SBL__MIN(SBL__ATLAS_INSET / SBL__MAX(sqrt(distance2), 1e-30), SBL__ATLAS_INSET_MOST);
    for (i = 0; i < 3; i++) weights[i] += share * (1 / 3.0 - weights[i]);
}

/* Returns the number of triangles, besides the one that a texel shows, that contain the texel's centre. */
static float sbl__atlas_others(const sbl__atlas *a, size_t texel) {
    return a->away && a->away[texel] < 0 ? (float)ceil(-(double)a->away[texel]) - 1 : 0;
}

/* Counts a texel when a second triangle contains its centre; the first time, warns. triangle: the one not shown */
static void sbl__atlas_warn_overlap(sbl__atlas *a, uint32_t triangle, size_t texel) {
    const sbl__geometry *g = a->geometry;
    const uint32_t first = a->texels[SBL__ATLAS_WORDS * texel] - 1;
    const int mesh = (int)g->vertices[g->indices[3 * (size_t)triangle]].object;
    const int first_mesh = (int)g->vertices[g->indices[3 * (size_t)first]].object;
    if (sbl__atlas_others(a, texel) > 0 || a->overlapping++) return;
    sbl__log(a->base, SBL_LOG_WARNING, SBL_LOG_ITEM_OVERLAP, "lightmap: triangle %d of mesh %d and triangle %d of mesh "
             "%d share texel %d %d; such texels show the light of the first triangle",
             (int)first - g->meshes[first_mesh].first_triangle, first_mesh,
             (int)triangle - g->meshes[mesh].first_triangle, mesh, (int)(texel % (size_t)a->width) / a->across,
             (int)(texel / (size_t)a->width) / a->across);
}

/* Makes the texel in column at[0] of row at[1] show a triangle if this is nearer to the texel's centre than the
   triangle shown so far. */
static void sbl__atlas_texel(sbl__atlas *a, const sbl__atlas_triangle *t, const int at[2]) {
    const size_t i = (size_t)at[1] * (size_t)a->width + (size_t)at[0];
    const double centre[2] = { at[0] + 0.5, at[1] + 0.5 };
    uint32_t *texel = a->texels + SBL__ATLAS_WORDS * i;
    double weights[3];
    const float away = (float)sbl__atlas_nearest(t, centre, weights);
    const int well = away <= SBL__ATLAS_WELL, other_chart = t->chart + 1 != texel[3];
    const int was_well = floor((double)a->away[i]) >= (double)a->away[i];  /* ATLAS_WELL - n is whole, EDGE - n not */
    float shares[2];
    if (away < 0 && a->away[i] < 0 && (other_chart || (well && was_well))) {
        sbl__atlas_warn_overlap(a, t->number, i);
        a->away[i] -= 1;
        return;
    }
    if (!(away < (texel[0] ? a->away[i] : SBL__ATLAS_FAR))) return;
    a->away[i] = away;
    if (!well) sbl__atlas_inset(t, weights);
    texel[0] = t->number + 1;
    shares[0] = (float)weights[1];
    shares[1] = (float)weights[2];
    memcpy(texel + 1, shares, sizeof shares);
    texel[3] = t->chart + 1;
}

/* Counts the triangle if a part of it is outside of the map; the first time, warns. */
static void sbl__atlas_warn_outside(sbl__atlas *a, const sbl__atlas_triangle *t) {
    const sbl__geometry *g = a->geometry;
    const int size[2] = { a->width, a->height }, mesh = (int)g->vertices[g->indices[3 * (size_t)t->number]].object;
    const double *outside = NULL;
    int i, k;
    for (i = 0; i < 3; i++)
        for (k = 0; k < 2; k++)
            if (t->corners[i][k] < -0.5 || t->corners[i][k] > size[k] + 0.5) outside = t->corners[i];
    if (!outside || a->outside++) return;
    sbl__log(a->base, SBL_LOG_WARNING, SBL_LOG_ITEM_OUTSIDE, "lightmap: triangle %d of mesh %d has a corner at %g %g; "
             "parts outside of 0 to 1 are not baked", (int)t->number - g->meshes[mesh].first_triangle, mesh,
             outside[0] / a->width, outside[1] / a->height);
}

/* Draws the rows of a triangle, beginning with a->row, until the slice is over. */
static sbl_result sbl__atlas_rows(sbl__atlas *a, uint32_t number, sbl__slice *slice) {
    sbl__atlas_triangle t;
    int at[2], columns[2];
    sbl__atlas_load(a, number, &t);
    if (a->row == 0) {
        double normal[3];
        a->world_area += sbl__scene_normal(a->geometry, number, normal);
        a->area += 0.5 * fabs(t.area);
        sbl__atlas_warn_outside(a, &t);
    }
    for (a->row = SBL__MAX(a->row, t.rows[0]); a->row <= t.rows[1]; a->row++) {
        if (a->row > t.rows[0] && sbl__late(slice)) return SBL_UNFINISHED;
        sbl__atlas_columns(a, &t, a->row, columns);
        at[1] = a->row;
        for (at[0] = columns[0]; at[0] <= columns[1]; at[0]++) sbl__atlas_texel(a, &t, at);
    }
    a->row = 0;
    return SBL_SUCCESS;
}

/* Returns the mean width of a texel in world units; 0 if no triangle covers any area of the map. */
static float sbl__atlas_texel_size(const sbl__atlas *a) {
    return a->area > 0 ? (float)sqrt(a->world_area / a->area) : 0;
}

static sbl_result sbl__atlas_draw(void *work, sbl__slice *slice) {
    sbl__atlas *a = (sbl__atlas *)work;
    int *at = &a->stages.at;
    for (; *at < a->geometry->triangle_count; ++*at) {
        if (sbl__late(slice)) return SBL_UNFINISHED;
        if (!sbl__atlas_is_baked(a, a->geometry->indices[3 * (size_t)*at])) continue;
        if (sbl__atlas_rows(a, (uint32_t)*at, slice) != SBL_SUCCESS) return SBL_UNFINISHED;
    }
    if (a->overlapping > 1 || a->outside > 1)
        sbl__log(a->base, SBL_LOG_WARNING, a->overlapping > 1 ? SBL_LOG_ITEM_OVERLAP : SBL_LOG_ITEM_OUTSIDE,
                 "lightmap: triangles overlap in %d texels; %d triangles lie partly outside", a->overlapping,
                 a->outside);
    sbl__free(a->base, a->parents);
    sbl__hash_table_free(a->base, &a->places);
    a->parents = NULL;
    return SBL_SUCCESS;
}

static int sbl__atlas_vertices(void *work) { return ((sbl__atlas *)work)->geometry->vertex_count; }
static int sbl__atlas_triangles(void *work) { return ((sbl__atlas *)work)->geometry->triangle_count; }

/* Does one piece of work. Returns SBL_SUCCESS when all texels are filled. */
static sbl_result sbl__atlas_step(sbl__atlas *a, sbl__slice *slice) {
    static const sbl__stage_row table[] = {
        { NULL, NULL, sbl__atlas_weld, sbl__atlas_vertices },
        { NULL, NULL, sbl__atlas_join, sbl__atlas_triangles },
        { NULL, NULL, sbl__atlas_number, sbl__atlas_vertices },
        { sbl__atlas_draw, NULL, NULL, NULL }
    };
    return sbl__stages_run(&a->stages, table, SBL__COUNT(table), a, slice);
}

/* ======================================================================================================== >>surface
   Draws G-buffers (section III-F). A picture has one for pixel centres and one for each anti-aliasing sample: the first
   pass finds the triangle that each pixel shows, the second computes its surface point, then the host draws over it. A
   lightmap has one, and the atlas gives the triangles and their points.

       triangles --visibility--> triangle per pixel --gbuffer--> position, normals, albedo, emission, id
         atlas     (depth)    -> and its point                   <-- the host's draw callback, same depth          */

enum { SBL__GBUFFER_POSITION, SBL__GBUFFER_NORMAL, SBL__GBUFFER_GEOMETRIC_NORMAL, SBL__GBUFFER_ALBEDO,
       SBL__GBUFFER_EMISSION, SBL__GBUFFER_ID, SBL__GBUFFER_COUNT };

typedef struct sbl__gbuffer { sbl__texture textures[SBL__GBUFFER_COUNT]; sbl__target target; } sbl__gbuffer;

typedef struct sbl__camera {
    double eye[3];             /* origin of view space, in world space */
    double right[3], up[3], back[3];  /* axes of view space in world space, unit vectors */
    float world_to_view[16], view_to_clip[16];
    int orthographic;
    double nearest, farthest;  /* orthographic: distances along the view direction where depth is 1 and 0 */
    float depth_scale;         /* perspective: depth is depth_scale / w */
    float facet_limit;         /* see sbl_picture_desc; 0: all facets get their shading normal */
} sbl__camera;

/* A request to draw a G-buffer. */
typedef struct sbl__surface_job {
    const sbl__scene *scene;
    const sbl__camera *camera;
    const sbl__gbuffer *gbuffer;
    float offset[2];           /* position of the sample relative to the pixel's centre, pixels */
    float epsilon;             /* ambient factor for the host's draw callback, see sbl_draw_view */
    int bounced;               /* 1: also store R of bounced light, see gbuffer_fragment.glsl */
    sbl__atlas *atlas;         /* the lightmap's atlas; NULL: draw a picture's G-buffer with `camera` */
} sbl__surface_job;

/* State of drawing a G-buffer. The textures are kept for the next G-buffer. */
typedef struct sbl__surface {
    sbl__stages stages;        /* stages.at: number of the next triangle or row */
    sbl__device *device;
    const sbl__surface_job *job;
    int row;                   /* first row of the band in progress; each band draws all triangles again */
    sbl__texture triangles, depth;
    sbl__target visibility;
    sbl__pace triangle_pace, point_pace;
} sbl__surface;

#define SBL__DEPTH_SHARE 1e-6      /* perspective: points nearer than this * the scene's extent all have depth 1 */
#define SBL__BAND_PIXELS 1048576   /* pixels of a band of rows, to which each draw is limited: triangles may be large */
#define SBL__TRIANGLE_PIXELS 64.0  /* cost of a triangle besides its pixels, in pixels */

static sbl_result sbl__gbuffer_make(const sbl__device *d, sbl__gbuffer *g, int width, int height,
                                    const sbl__texture *depth) {
    static const unsigned formats[SBL__GBUFFER_COUNT] = { SBL__GL_RGBA32F, SBL__GL_RGBA32F, SBL__GL_RGBA32F,
                                                          SBL__GL_RGBA16F, SBL__GL_RGBA32F, SBL__GL_R32UI };
    sbl_result result = SBL_SUCCESS;
    int i;
    for (i = 0; i < SBL__GBUFFER_COUNT && result == SBL_SUCCESS; i++)
        result = sbl__texture_make(d, &g->textures[i], width, height, formats[i]);
    return result == SBL_SUCCESS ? sbl__target_make(d, &g->target, g->textures, SBL__GBUFFER_COUNT, depth) : result;
}

static void sbl__gbuffer_free(const sbl__device *d, sbl__gbuffer *g) {
    int i;
    sbl__target_delete(d, &g->target);
    for (i = 0; i < SBL__GBUFFER_COUNT; i++) sbl__texture_delete(d, &g->textures[i]);
}

static sbl_result sbl__surface_make(const sbl__device *d, sbl__surface *s, int width, int height, int lightmap) {
    sbl_result result = sbl__texture_make(d, &s->triangles, width, height,
                                          lightmap ? SBL__GL_RGBA32UI : SBL__GL_R32UI);
    if (lightmap) return result;
    if (result == SBL_SUCCESS) result = sbl__texture_make(d, &s->depth, width, height, SBL__GL_DEPTH_COMPONENT32F);
    return result == SBL_SUCCESS ? sbl__target_make(d, &s->visibility, &s->triangles, 1, &s->depth) : result;
}

static void sbl__surface_free(const sbl__device *d, sbl__surface *s) {
    sbl__target_delete(d, &s->visibility);
    sbl__texture_delete(d, &s->triangles);
    sbl__texture_delete(d, &s->depth);
}

/* >>surface: the camera */

/* Makes a camera. desc: its matrices are checked already */
static void sbl__camera_make(sbl__camera *c, const sbl_picture_desc *desc, const sbl__geometry *g) {
    const float *m = desc->world_to_view;
    int i, k;
    memcpy(c->world_to_view, m, sizeof c->world_to_view);
    memcpy(c->view_to_clip, desc->view_to_clip, sizeof c->view_to_clip);
    for (k = 0; k < 3; k++) { c->right[k] = m[4 * k]; c->up[k] = m[4 * k + 1]; c->back[k] = m[4 * k + 2]; }
    for (k = 0; k < 3; k++) c->eye[k] = -(c->right[k] * m[12] + c->up[k] * m[13] + c->back[k] * m[14]);
    c->orthographic = desc->view_to_clip[11] == 0.0f;
    c->depth_scale = (float)SBL__DEPTH_SHARE * g->extent;
    c->facet_limit = SBL__MAX(desc->facet_limit, 0.0f);
    c->nearest = DBL_MAX;
    c->farthest = -DBL_MAX;
    for (i = 0; i < 8; i++) {
        double distance = 0;
        for (k = 0; k < 3; k++) distance -= c->back[k] * ((double)g->bounds[(i >> k) & 1][k] - c->eye[k]);
        sbl__extend(&c->nearest, &c->farthest, distance);
    }
    c->nearest -= 1e-3 * g->extent;
    c->farthest += 1e-3 * g->extent;
}

/* Sets world_to_view so that the whole scene is seen from the front (+z), a little from the right and from above. */
static void sbl__camera_frame(const sbl__geometry *g, sbl_picture_desc *d) {
    static const double way[3] = { 0.35, 0.3, 0.89 };
    const double zoom = SBL__MIN(fabs((double)d->view_to_clip[0]), fabs((double)d->view_to_clip[5]));
    double radius = 0, distance;
    float at[3], eye[3];
    int k;
    for (k = 0; k < 3; k++) {
        double half = 0.5 * ((double)g->bounds[1][k] - g->bounds[0][k]);
        radius += half * half;
        at[k] = (float)(0.5 * ((double)g->bounds[1][k] + g->bounds[0][k]));
    }
    radius = radius > 0 ? sqrt(radius) : 1;
    distance = d->view_to_clip[11] != 0.0f ? radius * sqrt(1 + zoom * zoom) : 2 * radius;
    for (k = 0; k < 3; k++) eye[k] = at[k] + (float)(way[k] * distance);
    sbl_look_at(d->world_to_view, eye[0], eye[1], eye[2], at[0], at[1], at[2], 0, 1, 0);
}

/* Gets view_to_clip for drawing the G-buffer: with the sample at `offset` (pixels) moved to the pixel's centre, the top
   row first, and reversed depth. */
static void sbl__camera_clip(const sbl__camera *c, const float offset[2], const sbl__target *t, float out[16]) {
    const float *m = c->view_to_clip;
    int k;
    memset(out, 0, 16 * sizeof(float));
    for (k = 0; k < 4; k++) {
        float w = m[4 * k + 3];
        out[4 * k] = m[4 * k] - 2 * offset[0] / (float)t->width * w;
        out[4 * k + 1] = -m[4 * k + 1] - 2 * offset[1] / (float)t->height * w;
        out[4 * k + 3] = w;
    }
    if (c->orthographic) {
        out[10] = (float)(1 / (c->farthest - c->nearest));
        out[14] = (float)(c->farthest / (c->farthest - c->nearest));
    } else out[14] = c->depth_scale;
}

/* >>glsl camera: shaders_embedded/camera.glsl, copied by scripts/embed_shaders */
static const char *const sbl__glsl_camera[] = {
"// Rays through the camera's pixels, in world space. Origin and direction are affine in the pixel's position.\n",
"uniform vec3 origin_0, origin_x, origin_y;\n",
"uniform vec3 direction_0, direction_x, direction_y;\n",
"\n",
"vec3 sbl_camera_origin() { return origin_0 + gl_FragCoord.x * origin_x + gl_FragCoord.y * origin_y; }\n",
"vec3 sbl_camera_direction() { return direction_0 + gl_FragCoord.x * direction_x + gl_FragCoord.y * direction_y; }\n",
0 };
/* <<glsl */

/* Sets the uniforms of camera.glsl, so that it computes the rays through the samples at `offset`. */
static void sbl__camera_set(const sbl__device *d, const sbl__camera *c, const float offset[2], const sbl__target *t) {
    static const char *const names[6] = { "origin_0", "origin_x", "origin_y",
                                          "direction_0", "direction_x", "direction_y" };
    const float *m = c->view_to_clip;
    const double a = c->orthographic ? 1 : -(double)m[11], step_x = 2.0 / t->width, step_y = -2.0 / t->height;
    const double x0 = -1 + offset[0] * step_x, y0 = 1 + offset[1] * step_y;
    const double dx = a * step_x / m[0], dy = a * step_y / m[5];
    const int moving = c->orthographic ? 0 : 3;  /* names[moving]: the first of the 3 that vary with the pixel */
    const int still = 3 - moving;
    /* x of the ray in view space. Perspective: at unit distance, (a * x in NDC + m8) / m0, where a = -m11 */
    const double across = c->orthographic ? (x0 - m[12]) / m[0] : (a * x0 + m[8]) / m[0];
    const double down = c->orthographic ? (y0 - m[13]) / m[5] : (a * y0 + m[9]) / m[5];
    float rays[6][3];
    int i, k;
    for (k = 0; k < 3; k++) {
        const double fixed = c->orthographic ? c->eye[k] : -c->back[k];
        rays[moving][k] = (float)(across * c->right[k] + down * c->up[k] + fixed);
        rays[moving + 1][k] = (float)(dx * c->right[k]);
        rays[moving + 2][k] = (float)(dy * c->up[k]);
        rays[still][k] = (float)(c->orthographic ? -c->back[k] : c->eye[k]);
        rays[still + 1][k] = rays[still + 2][k] = 0;
    }
    for (i = 0; i < 6; i++) sbl__set_vec3(d, names[i], rays[i]);
}

/* >>surface: the triangle that each pixel shows */

/* >>glsl visibility_vertex: shaders_embedded/visibility_vertex.glsl, copied by scripts/embed_shaders */
static const char *const sbl__glsl_visibility_vertex[] = {
"// Finds the triangle that each pixel of the camera shows. Depth is reversed: 1 at the near end, 0 at infinity.\n",
"uniform vec3 eye;\n",
"uniform vec4 clip_x, clip_y, clip_z, clip_w;  // rows of world to clip space, for positions relative to the eye\n",
"flat out int triangle;\n",
"\n",
"void main() {\n",
"    triangle = gl_VertexID / 3;\n",
"    int vertex = int(sbl_fetch(sbl_indices, gl_VertexID).x);\n",
"    vec4 p = vec4(sbl_vertex_position(vertex) - eye, 1);\n",
"    gl_Position = vec4(dot(clip_x, p), dot(clip_y, p), dot(clip_z, p), dot(clip_w, p));\n",
"    if ((sbl_object_flags(int(sbl_vertex_object(vertex))) & SBL_HIDDEN_FROM_CAMERA) != 0u)\n",
"        gl_Position = vec4(2, 2, 2, 1);\n",
"}\n",
0 };
/* <<glsl */

/* >>glsl visibility_fragment: shaders_embedded/visibility_fragment.glsl, copied by scripts/embed_shaders */
static const char *const sbl__glsl_visibility_fragment[] = {
"flat in int triangle;\n",
"// For drivers without clip control: depth = depth_from_w * gl_FragCoord.w. 0: orthographic\n",
"uniform float depth_from_w;\n",
"layout(location = 0) out uint out_triangle;  // 1 + number of the triangle; 0: the pixel shows none\n",
"\n",
"void main() {\n",
"#ifdef SBL_CUTOUTS\n",
"    if (sbl_has_holes(int(sbl_vertex_object(sbl_corners(triangle).x))))\n",
"        if (sbl_surface(triangle, sbl_camera_origin(), sbl_camera_direction()).material.cut_out) discard;\n",
"#endif\n",
"    out_triangle = uint(triangle) + 1u;\n",
"#ifdef SBL_WRITE_DEPTH\n",
"    gl_FragDepth = depth_from_w > 0.0 ? depth_from_w * gl_FragCoord.w : 2.0 * gl_FragCoord.z - 1.0;\n",
"#endif\n",
"}\n",
0 };
/* <<glsl */

static const sbl__recipe sbl__recipe_visibility = {
    "visibility", { sbl__glsl_scene, sbl__glsl_visibility_vertex },
    { sbl__glsl_scene, sbl__glsl_frame, sbl__glsl_material, sbl__glsl_surface, sbl__glsl_camera,
      sbl__glsl_visibility_fragment },
    { &sbl__vertex_record, &sbl__attributes_record, &sbl__object_record },
    SBL__CUTOUTS | SBL__WIDE | SBL__WRITE_DEPTH
};

#define SBL__BEFORE_CAMERA 1e-3  /* parts of a triangle where clip w is below this share of its largest w are cut off */

/* Estimates the number of pixels that a triangle covers in the band: half the area of the bounding rectangle, on the
   screen, of its part in front of the camera. band: x, y, width, height; rows: clip_x to clip_w of
   visibility_vertex.glsl */
static double sbl__triangle_pixels(const sbl__surface *s, const int band[4], float rows[4][4], uint32_t triangle) {
    const double *eye = s->job->camera->eye;
    const double size[2] = { (double)s->visibility.width, (double)s->visibility.height };
    const double low[2] = { 0, (double)band[1] }, high[2] = { size[0], (double)band[1] + band[3] };
    double from[2] = { DBL_MAX, DBL_MAX }, to[2] = { -DBL_MAX, -DBL_MAX }, v[3][4], before;
    int i, k;
    for (i = 0; i < 3; i++) {
        const float *p = sbl__triangle_corner(&s->job->scene->geometry, triangle, i);
        for (k = 0; k < 4; k++)
            v[i][k] = rows[k][0] * (p[0] - eye[0]) + rows[k][1] * (p[1] - eye[1]) + rows[k][2] * (p[2] - eye[2]) +
                      rows[k][3];
    }
    before = SBL__BEFORE_CAMERA * SBL__MAX(v[0][3], SBL__MAX(v[1][3], v[2][3]));
    if (!(before > 0)) return 0;
    for (i = 0; i < 3; i++) {
        const double *a = v[i], *b = v[(i + 1) % 3];
        const double t = (a[3] > before) != (b[3] > before) ? (before - a[3]) / (b[3] - a[3]) : 0;
        for (k = 0; k < 2; k++) {  /* extend from .. to by corner a if in front, and by edge ab's cut */
            if (a[3] > before) sbl__extend(&from[k], &to[k], (0.5 * a[k] / a[3] + 0.5) * size[k]);
            if (t > 0) sbl__extend(&from[k], &to[k], (0.5 * (a[k] + t * (b[k] - a[k])) / before + 0.5) * size[k]);
        }
    }
    for (k = 0; k < 2; k++) {
        from[k] = SBL__MAX(from[k], low[k]);
        to[k] = SBL__MIN(to[k], high[k]);
        if (from[k] >= to[k]) return 0;
    }
    return 0.5 * (to[0] - from[0]) * (to[1] - from[1]);
}

/* Draws as many triangles into the band as the slice has time for. The first call clears the target. */
static sbl_result sbl__surface_triangles(void *work, sbl__slice *slice) {
    static const char *const names[4] = { "clip_x", "clip_y", "clip_z", "clip_w" };
    sbl__surface *s = (sbl__surface *)work;
    sbl__device *d = s->device;
    const sbl__scene *scene = s->job->scene;
    const sbl__camera *c = s->job->camera;
    const sbl__geometry *g = &scene->geometry;
    const int most = SBL__MAX(1, SBL__BAND_PIXELS / s->visibility.width), at = s->stages.at;
    const int band[4] = { 0, s->row, s->visibility.width, SBL__MIN(most, s->visibility.height - s->row) };
    double room = sbl__pace_begin(&s->triangle_pace, slice, 65536, 1), pixels = 0;
    float clip[16], rows[4][4], eye[3];
    int end = at, i, k;
    sbl_result result;
    if (at == 0 && s->row == 0) {
        sbl__pass(d, &s->visibility, NULL, NULL, 0);
        sbl__clear(d, NULL);
    }
    if (!g->triangle_count) return sbl__gl_check(&d->gl);
    result = sbl__use(d, &sbl__recipe_visibility, scene->features);
    if (result != SBL_SUCCESS) return result;
    sbl__camera_clip(c, s->job->offset, &s->visibility, clip);
    for (i = 0; i < 4; i++) {
        for (k = 0; k < 3; k++)
            rows[i][k] = (float)(clip[i] * c->right[k] + clip[4 + i] * c->up[k] + clip[8 + i] * c->back[k]);
        rows[i][3] = clip[12 + i];
    }
    for (; end < g->triangle_count && pixels < room; end++)
        pixels += SBL__TRIANGLE_PIXELS + sbl__triangle_pixels(s, band, rows, (uint32_t)end);
    sbl__pass(d, &s->visibility, NULL, band, SBL__PASS_DEPTH);
    sbl__scene_bind(d, scene);
    sbl__camera_set(d, c, s->job->offset, &s->visibility);
    for (i = 0; i < 4; i++) sbl__set_vec4(d, names[i], rows[i]);
    for (i = 0; i < 3; i++) eye[i] = (float)c->eye[i];
    sbl__set_vec3(d, "eye", eye);
    sbl__set_float(d, "depth_from_w", c->orthographic ? 0 : c->depth_scale);
    sbl__draw_triangles(d, at, end - at);
    result = sbl__pace_end(d, &s->triangle_pace, pixels);
    s->stages.at = end % g->triangle_count;
    if (end == g->triangle_count) s->row += band[3];
    return result == SBL_SUCCESS && s->row < s->visibility.height ? SBL_UNFINISHED : result;
}

/* >>surface: surface points */

/* >>glsl gbuffer_fragment: shaders_embedded/gbuffer_fragment.glsl, copied by scripts/embed_shaders */
static const char *const sbl__glsl_gbuffer_fragment[] = {
"// Computes the surface points that the camera's pixels, or the texels of a lightmap, show.\n",
"uniform usampler2D triangles;  // output of visibility_fragment.glsl; lightmaps: see SBL__ATLAS_WORDS\n",
"uniform float facet_limit;     // pixels. Triangles whose least height on the screen is below this get their\n",
"                               // geometric normal, above twice this their shading normal, in between a mixture\n",
"layout(location = 0) out vec4 out_position;          // w: sbl_Surface.reach, see surface.glsl\n",
"layout(location = 1) out vec4 out_normal;\n",
"layout(location = 2) out vec4 out_geometric_normal;\n",
"layout(location = 3) out vec4 out_albedo;\n",
"layout(location = 4) out vec4 out_emission;\n",
"layout(location = 5) out uint out_id;\n",
"// In SBL_MODE_GI, w of normal, geometric normal and emission hold red, green and blue of the stored R. Where no\n",
"// sensor may stand, w of normal is -1 - red.\n",
"\n",
"#ifdef SBL_BOUNCED\n",
"// Returns the mean of the stored R over 5 x 5 points in about one cell, without the points where R is 0. Used\n",
"// where no sensor may stand, because there no sensor smooths R. points: 25, or 0 if the result is not needed\n",
"vec3 sbl_stored_smooth(int number, sbl_Surface s, int points) {\n",
"    mat3 frame = sbl_frame(s.geometric_normal);\n",
"    float step = 0.25 / per_cell, weight = 0.0;\n",
"    vec3 sum = vec3(0);\n",
"    for (int i = 0; i < points; i++) {\n",
"        vec3 place = s.position + step * (frame * vec3(i % 5 - 2, i / 5 - 2, 0));\n",
"        vec3 light = sbl_stored(number, s.back, place, SBL_UNBOUNDED);\n",
"        sum += light;\n",
"        weight += max(light.r, max(light.g, light.b)) > 0.0 ? 1.0 : 0.0;\n",
"    }\n",
"    return sum / max(weight, 1.0);\n",
"}\n",
"#endif\n",
"\n",
"void main() {\n",
"    uvec4 texel = texelFetch(triangles, ivec2(gl_FragCoord.xy), 0);\n",
"    uint triangle = texel.x;\n",
"    out_position = out_normal = out_geometric_normal = out_albedo = out_emission = vec4(0);\n",
"    out_id = 0u;\n",
"    if (triangle > 0u) {\n",
"#ifdef SBL_LIGHTMAP\n",
"        sbl_Surface s = sbl_surface_front(int(triangle) - 1, uintBitsToFloat(texel.y), uintBitsToFloat(texel.z));\n",
"        s.id = texel.w;\n",
"#else\n",
"        vec3 origin = sbl_camera_origin(), direction = sbl_camera_direction();\n",
"        sbl_Surface s = sbl_surface(int(triangle) - 1, origin, direction);\n",
"        // Width of a pixel at the surface, world units. Facets too small to be seen get their geometric normal.\n",
"        float pixel = length(origin_y + distance(s.position, origin) / length(direction) * direction_y);\n",
"        if (facet_limit > 0.0)\n",
"            s.normal = normalize(mix(s.geometric_normal, s.normal,\n",
"                                     clamp(s.facet / (facet_limit * pixel) - 1.0, 0.0, 1.0)));\n",
"#endif\n",
"        out_position = vec4(s.position, s.reach);\n",
"        out_normal = vec4(s.normal, 0);\n",
"        out_geometric_normal = vec4(s.geometric_normal, 0);\n",
"        out_albedo = vec4(s.material.albedo, 1);\n",
"        out_emission = vec4(s.emission, 0);\n",
"        out_id = s.id;\n",
"#ifdef SBL_BOUNCED\n",
"        bool excluded = (sbl_object_flags(s.object) & SBL_NO_SENSORS) != 0u;\n",
"        vec3 light = sbl_stored(int(triangle) - 1, s.back, s.position, SBL_UNBOUNDED);\n",
"        vec3 smooth_light = sbl_stored_smooth(int(triangle) - 1, s, excluded ? 25 : 0);\n",
"        if (excluded) light = smooth_light;\n",
"        out_normal.w = excluded ? -1.0 - light.r : light.r;\n",
"        out_geometric_normal.w = light.g;\n",
"        out_emission.w = light.b;\n",
"#endif\n",
"    }\n",
"}\n",
0 };
/* <<glsl */

static const sbl__recipe sbl__recipe_gbuffer = {
    "gbuffer", { sbl__glsl_fullscreen_vertex },
    { sbl__glsl_scene, sbl__glsl_frame, sbl__glsl_material, sbl__glsl_surface, sbl__glsl_camera, sbl__glsl_store,
      sbl__glsl_gbuffer_fragment },
    { &sbl__vertex_record, &sbl__attributes_record, &sbl__object_record, &sbl__cut_record, &sbl__leaf_record },
    SBL__TEXTURED | SBL__WIDE | SBL__BOUNCED | SBL__LIGHTMAP
};

/* Computes the surface points of as many rows as the slice has time for. */
static sbl_result sbl__surface_points(void *work, sbl__slice *slice) {
    sbl__surface *s = (sbl__surface *)work;
    const sbl__surface_job *job = s->job;
    sbl__device *d = s->device;
    const sbl__target *target = &job->gbuffer->target;
    const unsigned bounced = job->bounced ? SBL__BOUNCED : 0, lightmap = job->atlas ? SBL__LIGHTMAP : 0;
    const int rows = sbl__pace_rows(&s->point_pace, slice, target, s->stages.at);
    sbl_result result = sbl__use(d, &sbl__recipe_gbuffer, job->scene->features | bounced | lightmap);
    if (result != SBL_SUCCESS) return result;
    sbl__pass_rows(d, target, s->stages.at, rows);
    sbl__scene_bind(d, job->scene);
    if (bounced) sbl__store_bind(d, &job->scene->store);
    sbl__bind(d, "triangles", &s->triangles);
    sbl__camera_set(d, job->camera, job->offset, target);
    sbl__set_float(d, "facet_limit", job->camera->facet_limit);
    sbl__draw_screen(d);
    result = sbl__pace_end(d, &s->point_pace, (double)rows * target->width);
    s->stages.at += rows;
    return result == SBL_SUCCESS && s->stages.at < target->height ? SBL_UNFINISHED : result;
}

/* Lets the host draw over the G-buffer. */
static sbl_result sbl__surface_host(void *work, sbl__slice *slice) {
    const sbl__surface *s = (const sbl__surface *)work;
    const sbl__surface_job *job = s->job;
    const sbl__camera *c = job->camera;
    const sbl__target *target = &job->gbuffer->target;
    sbl_draw_view view;
    int k;
    (void)slice;
    if (!job->scene->draw) return SBL_SUCCESS;
    memset(&view, 0, sizeof view);
    view.kind = SBL_VIEW_CAMERA;
    view.viewport[2] = target->width;
    view.viewport[3] = target->height;
    memcpy(view.world_to_view, c->world_to_view, sizeof view.world_to_view);
    sbl__camera_clip(c, job->offset, target, view.view_to_clip);
    for (k = 0; k < 3; k++) view.eye[k] = (float)c->eye[k];
    view.radiance_scale = 1;
    view.depth_scale = c->depth_scale;
    view.epsilon = job->epsilon;
    sbl__host_draw(s->device, target, job->scene->draw, &view, job->scene->draw_user);
    return sbl__gl_check(&s->device->gl);
}

static sbl_result sbl__surface_atlas(void *work, sbl__slice *slice) {
    const sbl__surface *s = (const sbl__surface *)work;
    return sbl__atlas_step(s->job->atlas, slice);
}

/* Sends rows of the atlas to the GPU. */
static sbl_result sbl__surface_send(void *work, sbl__slice *slice) {
    sbl__surface *s = (sbl__surface *)work;
    const sbl__atlas *a = s->job->atlas;
    const int at = s->stages.at, rows = SBL__MIN(SBL__MAX(1, SBL__BAND_PIXELS / 16 / a->width), a->height - at);
    const sbl_result result = sbl__texture_write(s->device, &s->triangles, at, rows, a->texels + SBL__ATLAS_WORDS *
                                                 (size_t)at * (size_t)a->width);
    (void)slice;
    s->stages.at += rows;
    return result == SBL_SUCCESS && s->stages.at < a->height ? SBL_UNFINISHED : result;
}

/* Does one piece of work. Returns SBL_SUCCESS when the G-buffer is drawn; the next call begins a new one. A lightmap's
   atlas must have begun. */
static sbl_result sbl__surface_step(sbl__device *d, sbl__surface *s, const sbl__surface_job *job, sbl__slice *slice) {
    static const sbl__stage_row tables[2][3] = { {  /* stages of a picture */
        { sbl__surface_triangles, NULL, NULL, NULL },
        { sbl__surface_points, NULL, NULL, NULL },
        { sbl__surface_host, NULL, NULL, NULL }
    }, {  /* stages of a lightmap */
        { sbl__surface_atlas, NULL, NULL, NULL },
        { sbl__surface_send, NULL, NULL, NULL },
        { sbl__surface_points, NULL, NULL, NULL }
    } };
    sbl_result result;
    d->gl.doing = "drawing the G-buffer";
    s->device = d;
    s->job = job;
    result = sbl__stages_step(&s->stages, tables[job->atlas != NULL], SBL__COUNT(tables[0]), s, slice);
    if (result == SBL_SUCCESS) s->stages.stage = s->row = 0;
    return result;
}

/* ======================================================================================================== >>sensors
   Defines where and how incoming light is measured. The sensor at a site takes one or more looks, each with other
   directions; their mean is the site's reading. A look traces rays over the hemisphere or rasterises views of it. This
   room also lays out a look's views in a rectangle of texels, its sheet, and computes the weights of these texels. */

typedef struct sbl__site {
    float position[3];          /* world space, on a surface or in the air */
    float normal[3];            /* unit vector to the centre of the hemisphere; a surface's shading normal */
    float geometric_normal[3];  /* unit vector; the sensor is moved off the surface along it */
    float offset;               /* world distance by which the sensor is moved off the surface */
    uint32_t number;            /* seed for rotating the site's rays or views; differs between positions */
    int guide;                  /* number of the guide for the site's rays, see >>guide; 0: no guide */
    int first, looks;           /* the job takes `looks` looks, beginning with look number `first` */
} sbl__site;

/* Layers of light that a sensor measures. Layer 0 is R. Layers 1 to 4, which have signs, exist if the spec is
   directional: the radiance over the site's hemisphere, projected to the first two bands of spherical harmonics, in the
   order of sbl_probe. */
#define SBL__LAYERS 5

/* How all sensors of a job measure light. */
typedef struct sbl__spec {
    int traced;                 /* 1: sensors trace rays; 0: they rasterise views */
    int paper;                  /* 1: exactly the paper's method: unrotated views, weights by equation 4, emitters only
                                   seen in views, other kinds of lamps ignored. 0: lamp_rays measure all emission, so
                                   other rays and views do not see it */
    int hemicube;               /* rasterised: 1: five views form half a cube; 0: one view along the normal */
    int size;                   /* rasterised: width and height of a view, texels */
    float fov;                  /* rasterised, one view: field of view, degrees */
    int looks;                  /* maximum number of looks per site */
    int rays;                   /* traced: number of rays over the hemisphere per look */
    int lamp_rays;              /* maximum number of rays towards lamps per look, besides rim samples and rays to point
                                   lights; 0: no rays are aimed at lamps */
    int bounced;                /* 1 (SBL_MODE_GI): surfaces reflect the store's R; 0: ambient light, see epsilon */
    int without_sky;            /* traced: 1 if rays over the hemisphere see neither the sky nor the environment */
    int no_light;               /* traced: 1 if rays over the hemisphere cannot find light, so that only look 0 of each
                                   site traces them, for the distances and back faces in readings */
    int one_ray;                /* only for traced looks: 1: a look is a single ray along the normal, which measures
                                   radiance, as probes need it */
    int directional;            /* 1: measure layers 1 to 4 too, see SBL__LAYERS */
    float epsilon;              /* ambient factor: a surface that does not emit has the radiance epsilon * albedo */
    int view_texture_size;      /* sensor_texture_size of sbl_context_desc */
    int batch;                  /* maximum number of looks per batch */
    /* Jobs whose specs differ only from here on (seed, ...) use the same resources, see sbl__job_begin. */
    uint32_t seed;              /* seed for the rotation of all sensors, see sbl_picture_desc */
    int guided;                 /* 1: guides direct rays, see >>guide */
    float distance_limit;       /* traced: upper limit for each distance in a reading's mean distance; 0: no limit */
} sbl__spec;

#define SBL__MAX_LOOKS 512         /* maximum number of looks per site if the host sets target_error */
#define SBL__DEFAULT_LOOKS 16      /* maximum number of looks per site with the default target error */
#define SBL__LOOK_RAYS_MOST 128    /* looks that are too noisy get more rays, up to this number */
#define SBL__LOOK_VARIANCE 12.5    /* the rays of looks are doubled while the relative variance afterwards is at least
                                      this * (target error)^2, see sbl__look_growth */

/* One look of a site, as shaders read it:
   position         the site's position, moved off the surface by `offset` along the geometric normal
   rotation         rasterised: rotation of the views about the normal, radians
   scramble         traced: scrambles the points of the sequence that give the rays' directions, see sbl__sequence_at
   lamp_scramble    the same for rays towards lamps
   which            index among the site's looks, in the low SBL__LOOK_GUIDE_SHIFT bits: selects the section of the
                    sequence for the look's rays; above, the number of the site's guide */
#define SBL__LOOK_RECORD(X) \
    X(sbl__look, VEC3, position) X(sbl__look, FLOAT, rotation) \
    X(sbl__look, VEC3, normal) X(sbl__look, FLOAT, offset) \
    X(sbl__look, UVEC2, scramble) X(sbl__look, UINT, lamp_scramble) X(sbl__look, UINT, which)
SBL__RECORD(sbl__look, SBL__LOOK_RECORD, "sbl_look", "sbl_looks", SBL__BUFFER_TABLE("sbl_looks"), NULL)

/* Returns the seed of a sensor. number: sbl__site.number; seed: sbl__spec.seed */
static uint32_t sbl__sensor_seed(uint32_t number, uint32_t seed) { return sbl__hash(number ^ sbl__hash(seed)); }

/* Makes look number `look` of a site. Its rotation about the normal is the site's hash (0 to 1) plus the look number's
   radical inverse, in quarter turns, so that any number of looks are spread evenly over a quarter rotation. */
static void sbl__look_make(const sbl__spec *spec, const sbl__site *site, int look, sbl__look *out) {
    const uint32_t hash = sbl__sensor_seed(site->number, spec->seed);
    double rotation = 0, share = 0.5;  /* radical inverse of `look` in base 2; share: weight of k's lowest bit */
    int k;
    for (k = look; k > 0; k >>= 1, share *= 0.5) rotation += k & 1 ? share : 0;
    for (k = 0; k < 3; k++) {
        out->position[k] = site->position[k] + site->offset * site->geometric_normal[k];
        out->normal[k] = site->normal[k];
    }
    out->offset = site->offset;
    out->rotation = spec->paper ? 0 : (float)(0.5 * SBL__PI * (hash / 4294967296.0 + rotation));
    out->scramble[0] = sbl__hash(hash);
    out->scramble[1] = sbl__hash(hash + 1u);
    out->lamp_scramble = sbl__hash(hash + 2u);
    out->which = (uint32_t)look | (uint32_t)site->guide << SBL__LOOK_GUIDE_SHIFT;
}

/* >>sensors: views */

/* Positions of a look's views in its sheet, the rectangle of texels that holds them. */
typedef struct sbl__layout {
    int view_count;             /* 5 for a hemicube, otherwise 1 */
    double tangent;             /* tangent of half the field of view; 1 for a hemicube */
    int rects[5][4];            /* per view: x, y, width, height in the sheet, texels */
    int sheet[2];               /* width and height of the sheet without padding, texels */
    int block;                  /* width and height of a block: the square of texels that reduce_blocks.glsl adds up */
    int blocks[2];              /* number of blocks across and down; the sheet is padded to whole blocks */
} sbl__layout;

/* The vertex attributes of a view. sensor_vertex.glsl explains them. */
typedef struct sbl__view { float eye[3], right[4], up[4], forward[4], offset[2]; } sbl__view;

static void sbl__layout_make(sbl__layout *l, int hemicube, int size, float fov) {
    const int half = (size + 1) / 2;
    int i;
    memset(l, 0, sizeof *l);
    l->view_count = hemicube ? 5 : 1;
    l->tangent = hemicube ? 1 : tan(0.5 * (double)fov * SBL__PI / 180);
    l->sheet[0] = hemicube ? 2 * size : size;
    l->sheet[1] = hemicube ? SBL__MAX(size, 2 * half) + half : size;
    l->rects[0][2] = l->rects[0][3] = size;
    for (i = 1; i < l->view_count; i++) {
        l->rects[i][0] = i == 3 ? 0 : size;
        l->rects[i][1] = i == 1 ? 0 : i == 2 ? half : 2 * half;
        l->rects[i][2] = size;
        l->rects[i][3] = half;
    }
    l->block = size < 128 ? 8 : size < 256 ? 16 : 32;
    for (i = 0; i < 2; i++) l->blocks[i] = (l->sheet[i] + l->block - 1) / l->block;
}

/* Returns the width (axis 0) or height (axis 1) of a padded sheet, texels. */
static int sbl__layout_pitch(const sbl__layout *l, int axis) { return l->blocks[axis] * l->block; }

/* Computes two tangents of a unit normal (Duff et al. 2017, "Building an Orthonormal Basis, Revisited") and rotates
   them about it by `rotation` radians. right x up = -normal, as for a camera that looks along the normal. */
static void sbl__frame(const float n[3], double rotation, double right[3], double up[3]) {
    const double s = n[2] < 0.0f ? -1 : 1, a = -1 / (s + n[2]), b = (double)n[0] * n[1] * a;
    const double c = cos(rotation), d = sin(rotation);
    double t[3], u[3];
    int k;
    t[0] = 1 + s * n[0] * n[0] * a; t[1] = s * b; t[2] = -s * n[0];
    u[0] = -b; u[1] = -(s + (double)n[1] * n[1] * a); u[2] = n[1];
    for (k = 0; k < 3; k++) { right[k] = c * t[k] + d * u[k]; up[k] = c * u[k] - d * t[k]; }
}

/* Computes the axes of a look's view in world space. View 0 looks along the normal. Views 1 to 4 of a hemicube look
   sideways, and the normal is their up direction. */
static void sbl__view_axes(const sbl__look *l, int face, double right[3], double up[3], double forward[3]) {
    double t[3], u[3];
    int k;
    sbl__frame(l->normal, l->rotation, t, u);
    for (k = 0; k < 3; k++) {
        double n = l->normal[k];
        forward[k] = face == 0 ? n : face == 1 ? t[k] : face == 2 ? u[k] : face == 3 ? -t[k] : -u[k];
        up[k] = face == 0 ? u[k] : n;
        right[k] = face == 0 ? t[k] : face == 1 ? u[k] : face == 2 ? -t[k] : face == 3 ? -u[k] : t[k];
    }
}

/* Makes a view's vertex attributes. corner: lowest x and y of the look's sheet in the view texture; size: width and
   height of the part of this texture that is drawn to; all in texels */
static void sbl__view_make(const sbl__layout *l, const sbl__look *look, int face, const int corner[2],
                           const int size[2], sbl__view *out) {
    const int *r = l->rects[face];
    const float width = (float)size[0], height = (float)size[1];
    double right[3], up[3], forward[3];
    int k;
    sbl__view_axes(look, face, right, up, forward);
    for (k = 0; k < 3; k++) {
        out->eye[k] = look->position[k];
        out->right[k] = (float)(right[k] / l->tangent);
        out->up[k] = (float)(up[k] / l->tangent);
        out->forward[k] = (float)forward[k];
    }
    out->right[3] = (float)r[2] / width;
    out->offset[0] = (float)(2 * (corner[0] + r[0]) + r[2]) / width - 1;
    out->up[3] = (float)(face ? 2 * r[3] : r[3]) / height;
    out->offset[1] = (float)(2 * (corner[1] + r[1]) + (face ? 0 : r[3])) / height - 1;
    out->forward[3] = face ? 0.0f : -1.0f;
}

/* Gets the rectangle that a view covers in the plane at unit distance: lowest x, highest x, lowest y, highest y. The
   side views of a hemicube begin at the horizon, y = 0. */
static void sbl__view_range(const sbl__layout *l, int face, double range[4]) {
    range[0] = -l->tangent; range[1] = l->tangent;
    range[2] = face ? 0 : -l->tangent; range[3] = l->tangent;
}

/* >>sensors: weights */

/* Returns the form factor (projected solid angle divided by pi) of the rectangle [0, x] x [0, y] in a plane at unit
   distance (Cohen and Greenberg 1985, "The Hemi-Cube"). side = 0: the plane is perpendicular to the normal; integral of
   1 / (pi (1 + x^2 + y^2)^2). side = 1: the plane is parallel to the normal, which is its y axis; integral of
   y / (pi (1 + x^2 + y^2)^2). */
static double sbl__corner_weight(int side, double x, double y) {
    const double a = sqrt(1 + x * x), b = sqrt(1 + y * y);
    if (side) return (atan(x) - atan(x / b) / b) / (2 * SBL__PI);
    return (x / a * atan(y / a) + y / b * atan(x / b)) / (2 * SBL__PI);
}

/* Returns the form factor of the rectangle with the opposite corners from[] and to[] (x and y). */
static double sbl__rectangle_weight(int side, const double from[2], const double to[2]) {
    return sbl__corner_weight(side, to[0], to[1]) - sbl__corner_weight(side, from[0], to[1]) -
           sbl__corner_weight(side, to[0], from[1]) + sbl__corner_weight(side, from[0], from[1]);
}

/* Projects (x, y, 1) to the unit sphere, then along the normal to the tangent plane: V'' in the paper's equation 4. */
static void sbl__paper_project(double x, double y, double out[2]) {
    double length = sqrt(x * x + y * y + 1);
    out[0] = x / length;
    out[1] = y / length;
}

/* Returns the weight of a texel by the paper's equation 4, divided by pi. Section III-E multiplies it by the number
   of texels, rdx * rdy, and then takes the mean over them; both are omitted here. */
static double sbl__paper_weight(const double from[2], const double to[2]) {
    double v0[2], v1[2], v2[2];
    sbl__paper_project(from[0], from[1], v0);
    sbl__paper_project(to[0], from[1], v1);
    sbl__paper_project(from[0], to[1], v2);
    return fabs((v1[0] - v0[0]) * (v2[1] - v0[1]) - (v1[1] - v0[1]) * (v2[0] - v0[0])) / SBL__PI;
}

/* Computes row j of a view's weights. `weights` has two floats per texel of the padded sheet: the texel's form factor
   or, in the paper's mode, its sbl__paper_weight; and the ratio of distance to depth for the ray through its centre. */
static void sbl__weights_row(const sbl__layout *l, int paper, int face, int j, float *weights) {
    const int *r = l->rects[face];
    float *out = weights + 2 * ((size_t)(r[1] + j) * (size_t)sbl__layout_pitch(l, 0) + (size_t)r[0]);
    double range[4], dx, dy;
    int i;
    sbl__view_range(l, face, range);
    dx = (range[1] - range[0]) / r[2];
    dy = (range[3] - range[2]) / r[3];
    for (i = 0; i < r[2]; i++, out += 2) {
        const double from[2] = { range[0] + i * dx, range[2] + j * dy }, to[2] = { from[0] + dx, from[1] + dy };
        const double x = from[0] + 0.5 * dx, y = from[1] + 0.5 * dy;
        out[0] = (float)(paper ? sbl__paper_weight(from, to) : sbl__rectangle_weight(face > 0, from, to));
        out[1] = (float)sqrt(1 + x * x + y * y);
    }
}

/* ======================================================================================================== >>guide
   Sends more of a sensor's rays in directions where light was found nearby. If light comes through a window, for
   example, most cosine-distributed rays miss it. Scouts are therefore traced first: single cosine-distributed rays from
   a grid of pixels. A guide is a histogram over the hemisphere of the light that the scouts of one of these pixels and
   of its neighbours found. Its bins are rings about the normal, divided into sectors, all equally likely under the
   cosine distribution. Sensors near the pixel choose most of their directions by the guide, and divide the light of a
   ray by the factor by which the guide made its bin more likely. This leaves the expected value as it is and reduces
   the noise (scene living-room: to a fifth of the variance).

       u, uniform in the square  --guide-->  u, denser where light was found  --sbl_by_cosine-->  direction

   The density of a bin is the root mean square of its light, which gives the least variance (Rath and others 2020,
   "Variance-Aware Path Guiding"). The idea is from Mueller and others 2017, "Practical Path Guiding". */

#define SBL__GUIDE_BINS (SBL__GUIDE_RINGS * SBL__GUIDE_SECTORS)
#define SBL__GUIDE_WORDS (4 * SBL__GUIDE_TEXELS)
/* Even rays are cosine-distributed: the guide does not direct them. At least the share SBL__GUIDE_EVEN of all rays is
   even, so that light that no scout found is not missed. If the share of lit bins is above SBL__GUIDE_DARK, more rays
   are even; from SBL__GUIDE_LIT on, all are, because even rays sample uniform light with the least noise. */
#define SBL__GUIDE_EVEN 0.2
#define SBL__GUIDE_DARK 0.4
#define SBL__GUIDE_LIT 0.7
/* Distance between the pixels that have guides. A quarter or half of it is used if that gives fewer than
   SBL__GUIDES_FEW guides; otherwise it is doubled until there are fewer than SBL__GUIDES_MOST. */
#define SBL__GUIDE_STEP 8
#define SBL__GUIDES_FEW 4096
#define SBL__GUIDES_MOST 16384
#define SBL__SCOUTS 256            /* number of scout rays from each pixel of the grid */
#define SBL__SCOUTS_AT_ONCE 131072 /* maximum number of scout rays per job */

/* The guides of a picture, for the pixels of a grid. Guide number 0 belongs to no pixel and keeps the cosine
   distribution. The guide of grid pixel `place`, counted row by row, has number 1 + place. */
typedef struct sbl__guides {
    int columns, rows;          /* size of the grid */
    int step;                   /* distance between neighbours of the grid, in pixels of the picture */
    float *found;               /* per grid pixel and bin: sum of the squared luminances that the pixel's scouts found;
                                   NULL once the guides are made */
    uint32_t *words;            /* the guides, as guide.glsl reads them, SBL__GUIDE_WORDS each */
    sbl__texture texture;       /* copy of `words` on the GPU */
} sbl__guides;

static void sbl__guides_free(const sbl__device *d, sbl__guides *g) {
    sbl__free(d->base, g->found);
    sbl__free(d->base, g->words);
    sbl__texture_delete(d, &g->texture);
    memset(g, 0, sizeof *g);
}

/* Returns the index of the bin that contains a point of the unit square. */
static int sbl__guide_bin(double x, double y) {
    const int ring = (int)(x * SBL__GUIDE_RINGS), sector = (int)(y * SBL__GUIDE_SECTORS);
    return SBL__MIN(ring, SBL__GUIDE_RINGS - 1) * SBL__GUIDE_SECTORS + SBL__MIN(sector, SBL__GUIDE_SECTORS - 1);
}

/* Returns the weighted mean of a bin and its neighbours, to reduce noise: few scouts fall into one bin. */
static float sbl__guide_smooth(const float *found, int ring, int sector) {
    static const float weights[3] = { 0.2f, 0.6f, 0.2f };
    float sum = 0;
    int i, k;
    for (i = -1; i <= 1; i++)
        for (k = -1; k <= 1; k++) {
            const int r = SBL__MIN(SBL__MAX(ring + i, 0), SBL__GUIDE_RINGS - 1);
            const int s = (sector + k + SBL__GUIDE_SECTORS) % SBL__GUIDE_SECTORS;
            sum += weights[i + 1] * weights[k + 1] * found[r * SBL__GUIDE_SECTORS + s];
        }
    return sum;
}

/* Divides 0 .. SBL__GUIDE_STEPS into `count` intervals and writes where each begins, two 16-bit numbers per word. Part
   `even` (0 to 1) of the range, or all of it if all shares are 0, is divided equally, the rest by the shares. */
static void sbl__guide_intervals(const float *shares, int count, double even, uint32_t *words) {
    double all = 0, sum = 0;
    int i;
    for (i = 0; i < count; i++) all += shares[i];
    if (!(all > 0)) even = 1;
    for (i = 0; i < count; i++) {
        const double part = all > 0 ? sum / all : 0;
        const uint32_t begin = (uint32_t)(SBL__GUIDE_STEPS * ((1 - even) * part + even * i / count));
        if (i & 1) words[i / 2] |= begin << 16;
        else words[i / 2] = begin;
        sum += shares[i];
    }
}

/* Returns the share of even rays, SBL__GUIDE_EVEN to 1. The squared mean of the densities over their mean square is the
   share of lit bins: exactly if all lit bins have the same density, approximately otherwise. */
static double sbl__guide_even(const float *densities) {
    double sum = 0, squares = 0, lit;
    int i;
    for (i = 0; i < SBL__GUIDE_BINS; i++) {
        sum += densities[i];
        squares += (double)densities[i] * densities[i];
    }
    lit = squares > 0 ? sum * sum / (squares * SBL__GUIDE_BINS) : 1;
    lit = SBL__MIN(SBL__MAX((lit - SBL__GUIDE_DARK) / (SBL__GUIDE_LIT - SBL__GUIDE_DARK), 0.0), 1.0);
    return SBL__GUIDE_EVEN + (1 - SBL__GUIDE_EVEN) * lit;
}

/* Makes a guide. found: per bin, the sum of the squared luminances that scouts found */
static void sbl__guide_make(const float *found, uint32_t *words) {
    float rings[SBL__GUIDE_RINGS], densities[SBL__GUIDE_BINS];
    double even;
    int ring, sector;
    for (ring = 0; ring < SBL__GUIDE_RINGS; ring++) {
        rings[ring] = 0;
        for (sector = 0; sector < SBL__GUIDE_SECTORS; sector++) {
            float *density = &densities[ring * SBL__GUIDE_SECTORS + sector];
            *density = (float)sqrt((double)sbl__guide_smooth(found, ring, sector));
            rings[ring] += *density;
        }
    }
    even = sbl__guide_even(densities);
    for (ring = 0; ring < SBL__GUIDE_RINGS; ring++)
        sbl__guide_intervals(densities + ring * SBL__GUIDE_SECTORS, SBL__GUIDE_SECTORS, even,
                             words + (SBL__GUIDE_RINGS + ring * SBL__GUIDE_SECTORS) / 2);
    sbl__guide_intervals(rings, SBL__GUIDE_RINGS, even, words);
}

/* Returns where interval i of `count` begins, 0 to SBL__GUIDE_STEPS. i = count: where the last one ends */
static double sbl__guide_interval_begin(const uint32_t *words, int i, int count) {
    return i < count ? (double)(words[i / 2] >> (i & 1 ? 16 : 0) & 0xffffu) : SBL__GUIDE_STEPS;
}

/* Does the same as sbl_guide in guide.glsl: maps a uniform point u of the unit square to one that is distributed by the
   guide, and returns the weight of its ray. words: first word of the guide */
static double sbl__guide_warp(const uint32_t *words, double u[2]) {
    static const int counts[2] = { SBL__GUIDE_RINGS, SBL__GUIDE_SECTORS };
    double weight = 1;
    int axis;
    for (axis = 0; axis < 2; axis++) {
        const double x = u[axis] * SBL__GUIDE_STEPS;
        const int count = counts[axis];
        double begin, width;
        int i = 0;
        while (i + 1 < count && sbl__guide_interval_begin(words, i + 1, count) <= x) i++;
        begin = sbl__guide_interval_begin(words, i, count);
        width = sbl__guide_interval_begin(words, i + 1, count) - begin;
        u[axis] = (i + (x - begin) / width) / count;
        weight *= SBL__GUIDE_STEPS / (width * count);
        words += (SBL__GUIDE_RINGS + i * SBL__GUIDE_SECTORS) / 2;
    }
    return weight;
}

/* Returns the first word of guide number `guide`. */
static uint32_t *sbl__guide_words(const sbl__guides *g, int guide) {
    return g->words + (size_t)guide * SBL__GUIDE_WORDS;
}

/* Returns what the scouts of grid pixel number `place` found: SBL__GUIDE_BINS floats. */
static float *sbl__guide_found(const sbl__guides *g, int place) {
    return g->found + (size_t)place * SBL__GUIDE_BINS;
}

/* Returns the height of the guides' texture. Each row holds SBL__GUIDES_ACROSS guides. */
static int sbl__guide_rows(const sbl__guides *g) { return g->columns * g->rows / SBL__GUIDES_ACROSS + 1; }

/* >>sensors: data of both kinds of sensors, rasterised and traced */

/* Slots for looks, side by side in textures. Look number n of a job uses slot n % count, so that results do not depend
   on how the job is divided into batches. */
typedef struct sbl__slots {
    int columns, count;
    int blocks[2];              /* width and height of a slot in the textures of sbl__blocks, texels */
} sbl__slots;

/* Textures that the programs of sensors write: partial sums of the looks in all slots (see reduce_blocks.glsl and
   trace.glsl), or results of looks, or light from lamps. Textures 0 and 1 hold sums and hits. Directional jobs also
   need 2 to 4, the harmonics of red, green and blue light, and traced ones 5, out_even of trace.glsl. */
typedef struct sbl__blocks {
    sbl__texture textures[6];
    sbl__target target;
} sbl__blocks;

/* Returns the features (SBL__BOUNCED and others) that shaders need. */
static unsigned sbl__features_of(const sbl__scene *scene, const sbl__spec *spec) {
    return scene->features | (spec->bounced ? (unsigned)SBL__BOUNCED : 0) |
           (spec->guided ? (unsigned)SBL__GUIDED : 0) | (spec->directional ? (unsigned)SBL__DIRECTIONAL : 0);
}

/* Looks that are drawn or traced together. They use `count` slots, beginning with slot number `slot`. */
typedef struct sbl__batch {
    const sbl__scene *scene;
    const sbl__spec *spec;
    const sbl__slots *slots;
    const sbl__blocks *blocks;
    const sbl__look *looks;
    const sbl__table *table;    /* table of sbl__look, if rays are traced */
    const sbl__guides *guides;  /* NULL if the spec is not guided */
    int first;                  /* number of the first look among all looks of the job */
    int slot, count;
} sbl__batch;

/* Makes the first `count` textures and a target that draws to them. Deletes the other textures. */
static sbl_result sbl__blocks_make(const sbl__device *d, sbl__blocks *b, int count, int width, int height) {
    sbl_result result = SBL_SUCCESS;
    int i;
    for (i = 0; i < 6; i++) {
        sbl__texture *texture = &b->textures[i];
        if (i >= count) sbl__texture_delete(d, texture);
        else if (result == SBL_SUCCESS) result = sbl__texture_make(d, texture, width, height, SBL__GL_RGBA32F);
    }
    return result == SBL_SUCCESS ? sbl__target_make(d, &b->target, b->textures, count, NULL) : result;
}

static void sbl__blocks_free(const sbl__device *d, sbl__blocks *b) {
    int i;
    for (i = 0; i < 6; i++) sbl__texture_delete(d, &b->textures[i]);
    sbl__target_delete(d, &b->target);
}

/* Sends looks to the table that ray-tracing shaders read. room: capacity of the table, looks */
static sbl_result sbl__looks_send(const sbl__device *d, sbl__table *table, const sbl__look *looks, int count,
                                  int room) {
    const sbl_result result = sbl__buffer_stream(d, &table->buffer, sizeof *looks * (size_t)room, looks,
                                                 sizeof *looks * (size_t)count);
    return result == SBL_SUCCESS ? sbl__table_attach(d, table, SBL__GL_RGBA32UI, 0) : result;
}

/* >>glsl carrier: shaders_embedded/carrier.glsl, copied by scripts/embed_shaders */
static const char *const sbl__glsl_carrier[] = {
"// Shared by all programs that trace rays for sensors. Each look (see >>sensors in sbl.h) has a slot of blocks.x *\n",
"// blocks.y texels in the outputs, and one invocation computes each texel. The programs run either as fragment\n",
"// shaders, drawn over the slots, or as compute shaders, in which the invocations of a slot have consecutive\n",
"// numbers.\n",
"uniform ivec2 blocks;            // size of a slot, texels; at most 4 wide, so that parallel invocations trace\n",
"                                 // neighbouring rays\n",
"uniform int columns;             // number of slots in a row of the outputs\n",
"uniform int first_slot, count;   // the looks of this draw use `count` slots, beginning with slot first_slot\n",
"\n",
"const vec3 SBL_LUMINANCE = vec3(SBL_LUMINANCE_WEIGHTS);\n",
"const float SBL_COSINE_LEAST = 1e-6;  // lower limit of cosines before their reciprocal is taken\n",
"\n",
"// Converts 32-bit fractions to a point between 0 and 1.\n",
"vec2 sbl_unit_square(uvec2 fractions) { return (vec2(fractions >> 8) + 0.5) / SBL_FRACTIONS; }\n",
"\n",
"// Returns the factors that convert light from the unit direction w, given as its part of R, to its part of the\n",
"// first four coefficients of radiance in real spherical harmonics, in the order 1, y, z, x. R includes the cosine\n",
"// between w and the normal n, radiance does not. reciprocal: 1 / cosine\n",
"vec4 sbl_harmonics(vec3 w, vec3 n, float reciprocal) {\n",
"    vec3 way = n + reciprocal * (w - dot(w, n) * n);  // w / cosine; its part along n is 1\n",
"    return SBL_PI * vec4(SBL_HARMONIC_0 * reciprocal, SBL_HARMONIC_1 * way.yzx);\n",
"}\n",
"\n",
"#ifdef SBL_COMPUTE\n",
"layout(local_size_x = SBL_WORKGROUP) in;\n",
"#define SBL_OUT(place, name) layout(rgba32f, binding = place) writeonly uniform image2D name\n",
"#define sbl_write(name, value) imageStore(name, sbl_texel_of_invocation(), value)\n",
"#define sbl_leave return\n",
"\n",
"ivec2 sbl_texel_of_invocation() {\n",
"    int i = int(gl_GlobalInvocationID.x), size = blocks.x * blocks.y;\n",
"    int slot = first_slot + i / size, part = i % size;\n",
"    return ivec2(slot % columns, slot / columns) * blocks + ivec2(part % blocks.x, part / blocks.x);\n",
"}\n",
"#else\n",
"#define SBL_OUT(place, name) layout(location = place) out vec4 name\n",
"#define sbl_write(name, value) name = value\n",
"#define sbl_leave discard\n",
"\n",
"ivec2 sbl_texel_of_invocation() { return ivec2(gl_FragCoord.xy); }\n",
"#endif\n",
"\n",
"// SBL_OUT_HARMONICS declares three outputs, for the harmonics of red, green and blue light; a, b, c: the numbers\n",
"// that SBL_OUT gives them. sbl_write_harmonics writes them. Without SBL_DIRECTIONAL both do nothing.\n",
"#ifdef SBL_DIRECTIONAL\n",
"#define SBL_OUT_HARMONICS(a, b, c) SBL_OUT(a, out_red); SBL_OUT(b, out_green); SBL_OUT(c, out_blue);\n",
"#define sbl_write_harmonics(h) sbl_write(out_red, h[0]); sbl_write(out_green, h[1]); sbl_write(out_blue, h[2])\n",
"#else\n",
"#define SBL_OUT_HARMONICS(a, b, c)\n",
"#define sbl_write_harmonics(h)\n",
"#endif\n",
0 };
/* <<glsl */

/* ======================================================================================================== >>aim
   The sequence of points from which rays get their directions, and rays towards lamps, which both back ends trace. */

/* Limits of the work of one shader invocation. Some software renderers silently end an invocation after about 65,000
   loop iterations. A ray takes sbl__hierarchy.cost iterations on average, but some rays take several times more. */
#define SBL__LOOP_TURNS 20000      /* maximum number of loop iterations per invocation, on average */
#define SBL__RAY_TURNS 20          /* loop iterations per ray besides sbl__hierarchy.cost */
#define SBL__LAMP_CHUNK 256        /* maximum number of rays towards lamps per invocation */

/* Resources for rays towards lamps. */
typedef struct sbl__aim {
    int parts;                     /* number of invocations among which a look's rays to lamps are divided */
    sbl__table sequence;           /* points of the unit square that give directions, see sbl__sequence_make */
    sbl__blocks light;             /* outputs of lamps.glsl. Each look has a column of `parts` texels; a texel sums
                                      a part of the look's rays */
} sbl__aim;

/* Returns the maximum number of rays per invocation. */
static int sbl__rays_most(const sbl__hierarchy *h) {
    return SBL__MAX(1, (int)(SBL__LOOP_TURNS / (h->cost + SBL__RAY_TURNS)));
}

/* Computes the first `count` points of the two-dimensional Sobol sequence (Joe and Kuo 2008), as 32-bit fractions. */
static void sbl__sobol(uint32_t *out, int count) {
    int i, bit;
    for (i = 0; i < count; i++) {
        uint32_t x = 0, y = 0, direction = 0x80000000u;
        for (bit = 0; bit < 32; bit++, direction ^= direction >> 1)
            if ((uint32_t)i >> bit & 1u) { x |= 0x80000000u >> bit; y ^= direction; }
        out[2 * i] = x;
        out[2 * i + 1] = y;
    }
}

/* Comparison function for qsort: orders points along a Morton curve, so that neighbouring invocations trace rays of
   similar directions. Scrambling by exclusive or keeps neighbours close to each other. */
static int sbl__morton_order(const void *first, const void *second) {
    const uint32_t *a = (const uint32_t *)first, *b = (const uint32_t *)second;
    uint32_t x = a[0] ^ b[0], y = a[1] ^ b[1];
    int axis = x < y && x < (x ^ y);  /* axis in which the points differ in the higher bit */
    return a[axis] == b[axis] ? 0 : a[axis] < b[axis] ? -1 : 1;
}

/* Makes `rays` points for each of a site's looks: two 32-bit fractions per point. A look's points are divided into
   `sections`, each of which covers the unit square evenly. The caller frees the result; NULL: out of memory */
static uint32_t *sbl__sequence_make(sbl__base *base, int looks, int rays, int sections) {
    const size_t count = (size_t)rays, parts = (size_t)sections;
    uint32_t *points = (uint32_t *)sbl__alloc_raw(base, count * (size_t)looks, 8);
    size_t look, k;
    if (!points) return NULL;
    sbl__sobol(points, rays * looks);
    for (look = 0; look < (size_t)looks; look++)
        for (k = 0; k < parts; k++) {
            const size_t from = count * k / parts, to = count * (k + 1) / parts;
            if (to > from) qsort(points + 2 * (count * look + from), to - from, 8, sbl__morton_order);
        }
    return points;
}

/* Gets point i of a sequence, scrambled with the seed as in trace.glsl. u: both coordinates, 0 to 1 */
static void sbl__sequence_at(const uint32_t *sequence, int i, uint32_t seed, double u[2]) {
    int axis;
    for (axis = 0; axis < 2; axis++) {
        const uint32_t x = sequence[2 * i + axis] ^ sbl__hash(seed + (uint32_t)axis);
        u[axis] = ((x >> 8) + 0.5) / SBL__FRACTIONS;
    }
}

/* Maps a uniform point u of the unit square to a cosine-distributed direction, as sbl_by_cosine in frame.glsl does. */
static void sbl__cosine_direction(const float normal[3], const double u[2], float out[3]) {
    const double angle = 2 * SBL__PI * u[1];
    double right[3], up[3];
    int k;
    sbl__frame(normal, 0, right, up);  /* sbl__frame's up is opposite to the shader's, hence - sin */
    for (k = 0; k < 3; k++)
        out[k] = (float)(sqrt(u[0]) * (cos(angle) * right[k] - sin(angle) * up[k]) + sqrt(1 - u[0]) * normal[k]);
}

static sbl_result sbl__sequence_store(const sbl__device *d, sbl__table *t, int looks, int rays, int sections) {
    uint32_t *points = sbl__sequence_make(d->base, looks, rays, sections);
    sbl_result result;
    if (!points) return SBL_ERROR_OUT_OF_MEMORY;
    result = sbl__buffer_make(d, &t->buffer, (size_t)rays * (size_t)looks * 8, points, SBL__GL_STATIC_DRAW);
    sbl__free(d->base, points);
    return result == SBL_SUCCESS ? sbl__table_attach(d, t, SBL__GL_RG32UI, 0) : result;
}

/* Returns the number of invocations among which a look's rays towards lamps are divided. */
static int sbl__aim_parts(const sbl__spec *spec, const sbl__hierarchy *h) {
    const int chunk = spec->traced ? SBL__MIN(SBL__LAMP_CHUNK, sbl__rays_most(h)) : SBL__LAMP_CHUNK;
    return (spec->lamp_rays + chunk - 1) / chunk;
}

/* Makes the sequence, with a section for each pass of each invocation, and the outputs for looks in these slots. */
static sbl_result sbl__aim_setup(const sbl__device *d, sbl__aim *a, const sbl__spec *spec, const sbl__slots *slots,
                                 const sbl__hierarchy *h) {
    const int rows = (slots->count + slots->columns - 1) / slots->columns;
    sbl_result result;
    a->parts = sbl__aim_parts(spec, h);
    if (!spec->lamp_rays) return SBL_SUCCESS;
    result = sbl__sequence_store(d, &a->sequence, spec->looks, spec->lamp_rays, SBL__LAMP_PASSES * a->parts);
    return result == SBL_SUCCESS ? sbl__blocks_make(d, &a->light, spec->directional ? 4 : 1, slots->columns,
                                                    rows * a->parts) : result;
}

/* Sets the uniforms of all programs that trace sensors' rays. blocks: size of a look's rectangle of invocations */
static void sbl__rays_bind(sbl__device *d, const sbl__batch *b, const sbl__table *sequence, const int blocks[2]) {
    sbl__scene_bind(d, b->scene);
    sbl__hierarchy_bind(d, &b->scene->hierarchy);
    sbl__environment_bind(d, &b->scene->environment);
    if (b->spec->bounced) sbl__store_bind(d, &b->scene->store);
    sbl__bind_table(d, "sbl_looks", b->table);
    sbl__bind_table(d, "sbl_sequence", sequence);
    sbl__set_ints(d, "blocks", blocks[0], blocks[1]);
    sbl__set_int(d, "columns", b->slots->columns);
    sbl__set_int(d, "first_slot", b->slot);
    sbl__set_int(d, "count", b->count);
}

/* Runs the current program for all looks of a batch, blocks[0] x blocks[1] invocations each. */
static void sbl__rays_send(const sbl__device *d, const sbl__batch *b, const sbl__target *t, const int blocks[2]) {
    const int row = b->slot / b->slots->columns, last = (b->slot + b->count - 1) / b->slots->columns;
    sbl__invoke(d, t, row * blocks[1], (last - row + 1) * blocks[1], b->count * blocks[0] * blocks[1]);
}

/* >>glsl lamp: shaders_embedded/lamp.glsl, copied by scripts/embed_shaders */
static const char *const sbl__glsl_lamp[] = {
"// A single lamp as a point on a surface sees it: its light in closed form, a cluster's approximate light, the\n",
"// choice of one lamp from a cluster, and a random point on a lamp.\n",
"uniform int lamp_nodes, lamp_leaves;  // counts of nodes and of leaves in the table of lamps\n",
"uniform float unit;                   // radiance is divided by this unit while it is summed, to prevent overflow\n",
"#if defined(SBL_MIXED) || defined(SBL_BOUNCED)  // trace.glsl has no variants for SBL_MIXED\n",
"const bool mixed = true;            // lamps need not be triangles, and there may be more than SBL_LAMPS\n",
"#else\n",
"const bool mixed = false;           // all lamps are triangles, at most SBL_LAMPS\n",
"#endif\n",
"\n",
"const float SBL_SMALL = 16.0;       // a triangle is small if its squared distance over its squared size is larger\n",
"const float SBL_POINT[2] = float[2](-0.337845472747895, 0.725271359470687);  // see sbl_form_factor\n",
"const float SBL_POINT_WEIGHT[2] = float[2](0.223381589678011, 0.109951743655322);\n",
"const float SBL_BEFORE_LAMP = 0.99999;  // share of the distance to a lamp along which a ray is traced\n",
"\n",
"// A lamp as the sensor sees it. \"triangle:\", \"texel:\" and \"light:\" name the kinds of lamp that have a field.\n",
"struct sbl_Lamp {\n",
"    uint kind;\n",
"    vec3 brightness;           // divided by `unit`. triangle: radiance; texel: radiance above the limit * solid\n",
"                               // angle; light: irradiance of a surface at the sensor that faces the light\n",
"    vec3 corner;               // triangle: first corner, relative to the sensor; else unit direction to the centre\n",
"    vec3 side_1, side_2;       // triangle: vectors from the first corner to the other corners\n",
"    float away, radius, sine2; // light: distance, radius, squared sine of half the angle that it subtends\n",
"    ivec2 texel;               // texel: its column and row in the environment's picture\n",
"    int triangle, number;      // triangle: its number in the hierarchy's order and in the scene; else number is -1\n",
"    vec2 group;                // (0, 1) if it is a triangle that shows the sensor its back; else (1, 0)\n",
"};\n",
"\n",
"bool sbl_is_light(sbl_Lamp l) { return mixed && (l.kind == SBL_LAMP_NEAR_LIGHT || l.kind == SBL_LAMP_FAR_LIGHT); }\n",
"bool sbl_is_texel(sbl_Lamp l) { return mixed && l.kind == SBL_LAMP_SKY_TEXEL; }\n",
"\n",
"vec3 stand, position, n;     // the sensor: origin of rays; position on the surface, for closed forms; normal\n",
"float above;                 // distance of `stand` from the surface\n",
"mat3 to_frame;               // the sensor's frame, for closed forms\n",
"\n",
"sbl_Lamp sbl_lamp(int leaf) {\n",
"    uint code = sbl_lamp_leaf_code(leaf), at = code & ((1u << SBL_LAMP_KIND_SHIFT) - 1u);\n",
"    sbl_Lamp l = sbl_Lamp(code >> SBL_LAMP_KIND_SHIFT, vec3(0), vec3(0), vec3(0), vec3(0), SBL_UNBOUNDED, 0.0, 0.0,\n",
"                          ivec2(0), int(at), -1, vec2(1, 0));\n",
"    if (l.kind == SBL_LAMP_TRIANGLE) {\n",
"        int object = int(sbl_triangle_object(l.triangle));\n",
"        l.corner = sbl_triangle_corner_0(l.triangle);\n",
"        l.side_1 = sbl_triangle_corner_1(l.triangle) - l.corner;\n",
"        l.side_2 = sbl_triangle_corner_2(l.triangle) - l.corner;\n",
"        l.corner -= position;\n",
"        l.number = int(sbl_triangle_number(l.triangle));\n",
"        vec3 normal = cross(l.side_1, l.side_2);\n",
"        float off = dot(normal, l.corner);\n",
"        l.group = off > 0.0 ? vec2(0, 1) : vec2(1, 0);\n",
"        l.brightness = sbl_emission(object, l.group.y == 1.0) / unit;\n",
"        // Almost edge-on: no light. Excludes the sensor's own triangle, which rounding may put above the horizon.\n",
"        if (abs(off) < 0.5 * above * length(normal)) l.brightness = vec3(0);\n",
"    }\n",
"    if (sbl_is_texel(l)) {\n",
"        uint width = uint(textureSize(sky_picture, 0).x);\n",
"        l.texel = ivec2(at % width, at / width);\n",
"        vec2 size = vec2(textureSize(sky_picture, 0)), middle = (vec2(l.texel) + 0.5) / size;\n",
"        vec3 radiance = texelFetch(sky_picture, l.texel, 0).rgb;\n",
"        l.corner = sbl_sky_direction(middle.x, cos(SBL_PI * middle.y));\n",
"        l.brightness = radiance * (sbl_sky_excess(radiance) / unit * (2.0 * SBL_PI / size.x) * 2.0 *\n",
"                                   sin(SBL_PI * middle.y) * sin(0.5 * SBL_PI / size.y));\n",
"    }\n",
"    if (sbl_is_light(l)) {\n",
"        l.corner = sbl_light_position(int(at));\n",
"        l.brightness = sbl_light_intensity(int(at)) / unit;\n",
"        l.sine2 = sbl_light_radius(int(at));\n",
"        if (l.kind == SBL_LAMP_NEAR_LIGHT) {\n",
"            l.corner -= position;\n",
"            l.radius = l.sine2;\n",
"            l.away = length(l.corner);\n",
"            l.corner /= max(l.away, 1e-30);\n",
"            float spot = clamp(dot(sbl_light_axis(int(at)), -l.corner) * sbl_light_spot_scale(int(at)) +\n",
"                               sbl_light_spot_offset(int(at)), 0.0, 1.0);  // KHR_lights_punctual\n",
"            if (l.away < l.radius) { l.corner = n; l.away = l.radius; spot = 1.0; }  // sensor inside the light\n",
"            l.brightness *= spot * spot / (l.away * l.away);\n",
"            l.sine2 = min(l.radius * l.radius / (l.away * l.away), 1.0);\n",
"        }\n",
"    }\n",
"    return l;\n",
"}\n",
"\n",
"// >>closed forms\n",
"\n",
"// Form factor of a triangle. a, b, c: corners relative to the sensor, in its frame. Lambert's sum (1760) over the\n",
"// edges of the part above the horizon adds the angle that each edge subtends, times z of the unit normal of the\n",
"// plane through the edge and the sensor. If the triangle is small for its distance, rounding would spoil this sum;\n",
"// a sum over Dunavant's six points is then used instead (1985, degree 4; relative error up to 4e-6).\n",
"float sbl_form_factor(vec3 a, vec3 b, vec3 c) {\n",
"    vec3 corners[3] = vec3[3](a, b, c), entry = vec3(0), leave = vec3(0);\n",
"    vec3 middle = (a + b + c) / 3.0, normal = cross(b - a, c - a);\n",
"    float distance2 = dot(middle, middle), points = 0.0, sum = 0.0;\n",
"    float size2 = max(dot(b - a, b - a), max(dot(c - a, c - a), dot(c - b, c - b)));\n",
"    bool small = min(a.z, min(b.z, c.z)) > 0.0 && distance2 > SBL_SMALL * size2, cut = false;\n",
"    for (int k = 0; k < 6; k++) {  // points on the lines from the corners through the middle\n",
"        vec3 p = middle + SBL_POINT[k / 3] * (corners[k % 3] - middle);\n",
"        float length2 = dot(p, p) / distance2;\n",
"        points += SBL_POINT_WEIGHT[k / 3] * p.z / (length2 * length2);\n",
"    }\n",
"    int edges = small || max(a.z, max(b.z, c.z)) <= 0.0 ? 0 : 4;\n",
"    for (int k = 0; k < edges; k++) {\n",
"        vec3 p = k == 3 ? leave : corners[k], q = k == 3 ? entry : corners[k == 2 ? 0 : k + 1];\n",
"        if (k == 3 ? !cut : max(p.z, q.z) <= 0.0) continue;\n",
"        if (k < 3 && min(p.z, q.z) <= 0.0) {\n",
"            vec3 x = vec3(mix(p.xy, q.xy, p.z / (p.z - q.z)), 0);\n",
"            cut = true;\n",
"            if (p.z <= 0.0) entry = p = x;\n",
"            else leave = q = x;\n",
"        }\n",
"        vec3 across = cross(p, q);\n",
"        float size = length(across);\n",
"        sum += size > 0.0 ? atan(size, dot(p, q)) * across.z / size : 0.0;\n",
"    }\n",
"    return small ? points * 0.5 * abs(dot(normal, middle)) / (SBL_PI * distance2 * distance2)\n",
"                 : abs(sum) / (2.0 * SBL_PI);\n",
"}\n",
"\n",
"// Form factor of a round lamp, divided by sine2 (Snyder 1996, \"Area Light Sources for Real-Time Graphics\");\n",
"// small lamps are treated as flat discs. z: cosine between the normal and the direction to the lamp's centre\n",
"float sbl_round(float z, float sine2) {\n",
"    float sine = sqrt(sine2), s = sqrt(max(1.0 - z * z, 0.0));\n",
"    if (z >= sine || z <= -sine) return max(z, 0.0);\n",
"    float q = z / sine, x = sqrt(1.0 / sine2 - 1.0), y = clamp(-x * z / s, -1.0, 1.0), w = s * sqrt(1.0 - y * y);\n",
"    if (sine2 < 1e-4) return sine / SBL_PI * (q * acos(-q) + sqrt(1.0 - q * q) * (2.0 + q * q) / 3.0);\n",
"    return (z * acos(y) - x * w + atan(w, x) / sine2) / SBL_PI;\n",
"}\n",
"\n",
"// R from an unobstructed lamp. For a texel it is approximate: positive if any of the texel is above the horizon.\n",
"vec3 sbl_unhindered(sbl_Lamp l) {\n",
"    float factor = 0.0;\n",
"    if (l.kind == SBL_LAMP_TRIANGLE) {\n",
"        vec3 corner = to_frame * l.corner;\n",
"        factor = sbl_form_factor(corner, corner + to_frame * l.side_1, corner + to_frame * l.side_2);\n",
"    }\n",
"    if (sbl_is_light(l)) factor = sbl_round(dot(n, l.corner), l.sine2) / SBL_PI;\n",
"    if (sbl_is_texel(l))\n",
"        factor = max(dot(n, l.corner) + SBL_PI / float(textureSize(sky_picture, 0).y), 0.0) / SBL_PI;\n",
"    return l.brightness * factor;\n",
"}\n",
"\n",
"// The first four spherical harmonics of an unobstructed lamp, from its solid angle and from the integral of\n",
"// directions over it (`way`). If the horizon cuts a round lamp, all but the part along the normal is approximate.\n",
"mat3x4 sbl_unhindered_harmonics(sbl_Lamp l) {\n",
"    float solid_angle = 0.0;\n",
"    vec3 way = vec3(0);\n",
"    if (l.kind == SBL_LAMP_TRIANGLE) {\n",
"        vec3 a = to_frame * l.corner, kept[4];\n",
"        vec3 corners[3] = vec3[3](a, a + to_frame * l.side_1, a + to_frame * l.side_2);\n",
"        int count = 0;\n",
"        for (int k = 0; k < 3; k++) {\n",
"            vec3 p = corners[k], q = corners[(k + 1) % 3];\n",
"            if (p.z > 0.0) kept[count++] = p;\n",
"            if ((p.z > 0.0) != (q.z > 0.0)) kept[count++] = vec3(mix(p.xy, q.xy, p.z / (p.z - q.z)), 0);\n",
"        }\n",
"        for (int k = 0; k < count; k++) {  // R of a polygon as a sum over its edges (Lambert 1760)\n",
"            vec3 p = kept[k], q = kept[k + 1 < count ? k + 1 : 0], across = cross(p, q);\n",
"            float size = length(across);\n",
"            way += size > 0.0 ? 0.5 * atan(size, dot(p, q)) / size * across : vec3(0);\n",
"        }\n",
"        for (int k = 1; k + 1 < count; k++) {  // Van Oosterom and Strackee 1983\n",
"            vec3 p = kept[0], q = kept[k], r = kept[k + 1], lengths = vec3(length(p), length(q), length(r));\n",
"            float cosines = lengths.x * lengths.y * lengths.z + dot(p, q) * lengths.z + dot(q, r) * lengths.x +\n",
"                            dot(r, p) * lengths.y;\n",
"            solid_angle += 2.0 * atan(dot(p, cross(q, r)), cosines);\n",
"        }\n",
"        way = transpose(to_frame) * way * sign(solid_angle);\n",
"        solid_angle = abs(solid_angle);\n",
"    }\n",
"    if (sbl_is_light(l)) {  // solid_angle and way are divided by pi * sine2, to fit l.brightness\n",
"        float z = dot(n, l.corner), shown = clamp(0.5 + 0.5 * z / max(sqrt(l.sine2), 1e-30), 0.0, 1.0);\n",
"        solid_angle = shown * 2.0 / (1.0 + sqrt(1.0 - l.sine2));\n",
"        way = shown * (l.corner - z * n) + sbl_round(z, l.sine2) * n;\n",
"    }\n",
"    return outerProduct(vec4(SBL_HARMONIC_0 * solid_angle, SBL_HARMONIC_1 * way.yzx), l.brightness);\n",
"}\n",
"\n",
"// >>clusters\n",
"\n",
"struct sbl_Cluster {\n",
"    vec3 to;       // centre of its bounding sphere, relative to the sensor; if `far`, a direction\n",
"    float radius;\n",
"    bool far;      // true: the lamps are infinitely far away\n",
"    int beyond;    // next node that is not in the cluster's subtree\n",
"};\n",
"\n",
"sbl_Cluster sbl_cluster(int node) {\n",
"    uint beyond = sbl_lamp_node_beyond(node);\n",
"    bool far = (beyond & SBL_FAR_NODE) != 0u;\n",
"    return sbl_Cluster(sbl_lamp_node_middle(node) - (far ? vec3(0) : position), sbl_lamp_node_radius(node), far,\n",
"                       int(beyond & ~SBL_FAR_NODE));\n",
"}\n",
"\n",
"// Approximate light of an unobstructed cluster; 0 only if none of its lamps gives light to the sensor.\n",
"float sbl_strength(int node, sbl_Cluster c) {\n",
"    vec3 square = sbl_lamp_node_square(node), mixed = sbl_lamp_node_mixed(node), front = sbl_lamp_node_front(node);\n",
"    float distance2 = max(dot(c.to, c.to), 1e-37), spread = min(c.radius * inversesqrt(distance2), 1.0);\n",
"    float height = dot(n, c.to);\n",
"    // The normal of a far lamp is the direction towards it, so its product with -n is the cosine at the sensor.\n",
"    vec3 w = c.far ? -n : c.to * inversesqrt(distance2);\n",
"    float shown = sqrt(max(dot(square, w * w) + 2.0 * dot(mixed, w.xyz * w.yzx), 0.0)) - dot(front, w) +\n",
"                  0.1 * sbl_lamp_node_power(node) * spread;\n",
"    if (height + c.radius <= 0.0) return 0.0;\n",
"    float near = max(height, 0.5 * (height + c.radius)) * inversesqrt(distance2) /\n",
"                 max(distance2, c.radius * c.radius);\n",
"    return max(shown, 0.0) * (c.far ? 1.0 : near) / unit;\n",
"}\n",
"\n",
"// >>points of lamps\n",
"\n",
"// Maps u to a uniformly distributed direction in the spherical triangle of the unit vectors a, b, c (Arvo 1995,\n",
"// \"Stratified Sampling of Spherical Triangles\"). w: the solid angle; 0 if it is too small for this method\n",
"vec4 sbl_spherical(vec3 a, vec3 b, vec3 c, vec2 u) {\n",
"    vec3 ab = cross(a, b), bc = cross(b, c), ca = cross(c, a);\n",
"    float alpha = atan(length(cross(ab, ca)), -dot(ab, ca)), beta = atan(length(cross(bc, ab)), -dot(bc, ab));\n",
"    float gamma = atan(length(cross(ca, bc)), -dot(ca, bc)), solid_angle = alpha + beta + gamma - SBL_PI;\n",
"    if (!(solid_angle > 0.01)) return vec4(0);\n",
"    float s = sin(u.x * solid_angle - alpha), t = cos(u.x * solid_angle - alpha);\n",
"    float sin_alpha = sin(alpha), cos_alpha = cos(alpha);\n",
"    float p = t - cos_alpha, v = s + sin_alpha * dot(a, b);\n",
"    float q = clamp(((v * t - p * s) * cos_alpha - v) / ((v * s + p * t) * sin_alpha), -1.0, 1.0);\n",
"    vec3 cut = q * a + sqrt(1.0 - q * q) * normalize(c - dot(c, a) * a);\n",
"    float z = 1.0 - u.y * (1.0 - dot(cut, b));\n",
"    return vec4(z * b + sqrt(max(1.0 - z * z, 0.0)) * normalize(cut - dot(cut, b) * b), solid_angle);\n",
"}\n",
"\n",
"struct sbl_Sample {\n",
"    vec3 direction;\n",
"    float far;    // distance, or SBL_UNBOUNDED\n",
"    vec3 light;   // R / unit from the lamp, estimated from this point alone\n",
"    vec2 b;       // triangle: weights of the second and third corner\n",
"};\n",
"\n",
"// Weights of a triangle's second and third corner at a point. from_corner: the point, relative to the first corner\n",
"vec2 sbl_barycentrics(sbl_Lamp l, vec3 normal, vec3 from_corner) {\n",
"    vec2 areas = vec2(dot(cross(from_corner, l.side_2), normal), dot(cross(l.side_1, from_corner), normal));\n",
"    return areas / dot(normal, normal);\n",
"}\n",
"\n",
"// Maps a uniform point u of the unit square to a point on a lamp. Triangles are sampled by solid angle, or by area\n",
"// if the solid angle is small (Heitz 2019, \"A Low-Distortion Map Between Triangle and Square\").\n",
"sbl_Sample sbl_sample(sbl_Lamp l, vec2 u) {\n",
"    sbl_Sample s = sbl_Sample(l.corner, SBL_UNBOUNDED, l.brightness / SBL_PI, u);\n",
"    if (l.kind == SBL_LAMP_TRIANGLE) {\n",
"        vec3 normal = cross(l.side_1, l.side_2), corner_1 = l.corner + l.side_1, corner_2 = l.corner + l.side_2;\n",
"        vec4 ray = sbl_spherical(normalize(l.corner), normalize(corner_1), normalize(corner_2), u);\n",
"        s.b = u.y > u.x ? vec2(0.5 * u.x, u.y - 0.5 * u.x) : vec2(u.x - 0.5 * u.y, 0.5 * u.y);\n",
"        // Keep a distance to the edges, so that rounding does not make the ray miss the triangle.\n",
"        float reach2 = dot(l.corner, l.corner), longest2 = max(dot(l.side_1, l.side_1), dot(l.side_2, l.side_2));\n",
"        float keep = 3e-6 * sqrt(longest2) * reach2 / max(abs(dot(normal, l.corner)), 1e-37);\n",
"        s.b = mix(s.b, vec2(1.0 / 3.0), min(keep, 0.5));\n",
"        vec3 to = l.corner + s.b.x * l.side_1 + s.b.y * l.side_2;\n",
"        if (ray.w > 0.0) {\n",
"            to = ray.xyz * dot(l.corner, normal) / dot(ray.xyz, normal);\n",
"            s.b = sbl_barycentrics(l, normal, to - l.corner);\n",
"        }\n",
"        s.far = length(to);\n",
"        s.direction = to / s.far;\n",
"        s.light *= ray.w > 0.0 ? ray.w : 0.5 * abs(dot(normal, s.direction)) / (s.far * s.far);\n",
"    }\n",
"    if (sbl_is_texel(l)) {\n",
"        vec2 size = vec2(textureSize(sky_picture, 0));\n",
"        float row = float(l.texel.y);\n",
"        s.direction = sbl_sky_direction((float(l.texel.x) + u.x) / size.x,\n",
"                                        mix(cos(SBL_PI * row / size.y), cos(SBL_PI * (row + 1.0) / size.y), u.y));\n",
"    }\n",
"    if (sbl_is_light(l)) {\n",
"        // off: 1 - cosine of the angle between the ray and the direction to the centre\n",
"        float cosine = sqrt(1.0 - l.sine2), off = u.x * l.sine2 / (1.0 + cosine);\n",
"        float r = sqrt(max(off * (2.0 - off), 0.0)), angle = 2.0 * SBL_PI * u.y;\n",
"        s.direction = sbl_frame(l.corner) * vec3(r * cos(angle), r * sin(angle), 1.0 - off);\n",
"        s.light *= 2.0 / (1.0 + cosine);\n",
"        if (l.kind == SBL_LAMP_NEAR_LIGHT)\n",
"            s.far = l.away * (1.0 - off) - sqrt(max(l.radius * l.radius - l.away * l.away * r * r, 0.0));\n",
"    }\n",
"    s.light *= max(dot(n, s.direction), 0.0);\n",
"    return s;\n",
"}\n",
"\n",
"#ifdef SBL_VIEWS  // geometry that only the host can draw: the sensor's views tell whether it hides the lamp\n",
"uniform sampler2D view_texture; // radiance towards the sensor; distance along the view's axis, < 0 for a back face\n",
"uniform vec4 view_rects[5];     // per view: x, y, width, height in the sheet, texels\n",
"uniform ivec2 sheet;            // size of a sheet (the views of one look), texels\n",
"uniform int view_count;\n",
"uniform float tangent;          // tangent of half the field of view\n",
"uniform float extent;           // scene extent: unit of the view texture's distances, world units\n",
"\n",
"const float SBL_AT_LAMP = 0.002;  // relative tolerance for distances in views, which are 16-bit floats\n",
"const int SBL_LOOKS_AGAIN = 4;    // maximum number of texels that sbl_hidden compares for one ray\n",
"\n",
"// Returns true if the views show something in front of the sample, or do not cover its direction. The direction of\n",
"// a texel's centre may miss the lamp's triangle; a point closer to the triangle's middle is then compared.\n",
"bool sbl_hidden(int slot, sbl_Lamp l, sbl_Sample s) {\n",
"    float turn = sbl_look_rotation(look);\n",
"    mat3 frame = sbl_frame(n);\n",
"    vec3 side_x = cos(turn) * frame[0] - sin(turn) * frame[1];\n",
"    vec3 side_y = -cos(turn) * frame[1] - sin(turn) * frame[0];\n",
"    vec3 sides[4] = vec3[4](side_x, side_y, -side_x, -side_y);  // axes of the side views, see sbl__view_axes\n",
"    vec3 normal = cross(l.side_1, l.side_2), point = s.far * s.direction;\n",
"    vec3 middle = l.corner + (l.side_1 + l.side_2) / 3.0;\n",
"    if (l.kind != SBL_LAMP_TRIANGLE) point = s.direction;\n",
"    for (int attempt = 0; attempt < SBL_LOOKS_AGAIN; attempt++, point = mix(point, middle, 0.4)) {\n",
"        vec2 side = vec2(dot(point, side_x), dot(point, side_y));\n",
"        bool top = max(abs(side.x), abs(side.y)) <= dot(point, n) * tangent;\n",
"        int face = top ? 0 : abs(side.x) > abs(side.y) ? (side.x > 0.0 ? 1 : 3) : (side.y > 0.0 ? 2 : 4);\n",
"        if (!top && view_count == 1) return true;\n",
"        vec3 forward = top ? n : sides[max(face, 1) - 1], right = top ? side_x : sides[face % 4];\n",
"        vec3 up = top ? side_y : n;\n",
"        vec4 rect = view_rects[face];\n",
"        vec2 lowest = vec2(-1, top ? -1 : 0), size = vec2(1) - lowest;\n",
"        vec2 at = (vec2(dot(point, right), dot(point, up)) / (dot(point, forward) * tangent) - lowest) / size;\n",
"        vec2 texel = clamp(floor(at * rect.zw), vec2(0), rect.zw - 1.0);\n",
"        vec2 centre = lowest + (texel + 0.5) / rect.zw * size;\n",
"        ivec2 place = ivec2(slot % columns, slot / columns) * sheet + ivec2(rect.xy + texel);\n",
"        float shown = texelFetch(view_texture, place, 0).a, seen = abs(shown) * extent;\n",
"        if (seen == 0.0) return false;\n",
"        if (l.kind != SBL_LAMP_TRIANGLE) return seen < (1.0 - SBL_AT_LAMP) * s.far * dot(point, forward);\n",
"        vec3 ray = forward + tangent * (centre.x * right + centre.y * up);\n",
"        float there = dot(l.corner, normal) / dot(ray, normal);  // depth along `forward` of the lamp's plane\n",
"        bool other_side = (shown < 0.0) != (l.group.y == 1.0);   // the view shows the back of the lamp\n",
"        bool beyond = seen > (1.0 + SBL_AT_LAMP) * there;\n",
"        if (there > 0.0 && (beyond || (seen >= (1.0 - SBL_AT_LAMP) * there && !other_side))) return false;\n",
"        vec2 b = sbl_barycentrics(l, normal, there * ray - l.corner);\n",
"        if (attempt == SBL_LOOKS_AGAIN - 1 || (there > 0.0 && min(b.x, b.y) >= 0.0 && b.x + b.y <= 1.0))\n",
"            return seen < (other_side ? 1.0 + SBL_AT_LAMP : 1.0 - SBL_AT_LAMP) * dot(point, forward);\n",
"    }\n",
"    return true;\n",
"}\n",
"#endif\n",
"\n",
"struct sbl_Pick {\n",
"    int leaf;      // the lamp that is picked\n",
"    float share;   // probability of picking this lamp\n",
"    vec2 u;        // uniform point for sbl_sample; each choice by u.x rescales it, so that it stays uniform\n",
"    bool cluster;  // true: the lamp was picked from a cluster\n",
"};\n",
"\n",
"// Picks one lamp of a cluster: descends its subtree, at each node in proportion to the strengths of the children.\n",
"// node: -1: the cluster of all lamps, if there are near ones and far ones\n",
"void sbl_descend(inout sbl_Pick p, int node, uint fraction) {\n",
"    // Adds the low bits of the fraction, which a float between 0 and 1 cannot hold.\n",
"    p.u.x = clamp(p.u.x + (float(fraction & 255u) - 127.5) / 4294967296.0 / p.share, 0.0, 1.0);\n",
"    int beyond = node < 0 ? lamp_nodes : sbl_cluster(node).beyond;\n",
"    for (; beyond != node + 1; beyond = sbl_cluster(node).beyond) {\n",
"        sbl_Cluster left = sbl_cluster(node + 1), right = sbl_cluster(left.beyond);\n",
"        float weight = sbl_strength(node + 1, left);\n",
"        float share = weight / max(weight + sbl_strength(left.beyond, right), 1e-37);\n",
"        bool first = p.u.x < share;\n",
"        node = first ? node + 1 : left.beyond;\n",
"        p.share *= first ? share : 1.0 - share;\n",
"        p.u.x = first ? p.u.x / share : (p.u.x - share) / (1.0 - share);\n",
"    }\n",
"    p.leaf = int(sbl_lamp_node_first_leaf(node));\n",
"}\n",
0 };
/* <<glsl */

/* >>glsl lamps: shaders_embedded/lamps.glsl, copied by scripts/embed_shaders */
static const char *const sbl__glsl_lamps[] = {
"// Light from lamps: emitting triangles, lights, and bright texels of the sky. The light of an unobstructed lamp is\n",
"// known in closed form, and rays measure which share of it arrives: the ratio estimator of Heitz, Hill and McGuire\n",
"// 2018, \"Combining analytic direct illumination and stochastic shadows\". If there are many lamps, distant ones\n",
"// form clusters; a ray towards a cluster picks one of its lamps, in proportion to their light.\n",
"//\n",
"//     choose   makes the list of entries: the lamps and clusters that give this sensor light, with their strengths\n",
"//     pick     picks one of the entries for a ray\n",
"//     shoot    traces the ray\n",
"//     combine  computes R from the results of all rays and from the closed forms\n",
"//\n",
"// One invocation computes one look, or one of the `blocks.y` parts into which its rays are divided. It stops when\n",
"// more rays would not improve the result. With SBL_INSPECT it reports one ray or one entry of the look.\n",
"uniform usamplerBuffer sbl_sequence;  // points of the unit square for the rays, as in trace.glsl\n",
"uniform int rays;                     // maximum number of rays per look, besides those to rims and point lights\n",
"uniform float scale;                  // output / R\n",
"#ifdef SBL_INSPECT\n",
"const bool inspected = true, directional = false;\n",
"uniform int parts;                    // number of invocations among which the measurement divides a look's rays\n",
"uniform int sheet_slot;               // slot of the look's views in the view texture\n",
"SBL_OUT(0, out_light);                // rgb: light of a ray, or unobstructed R of an entry; a: ray: 0: not traced,\n",
"                                      // 1: reached the lamp, 2: blocked; entry: 1: lamp, 2: visible point light,\n",
"                                      // 3: hidden point light\n",
"SBL_OUT(1, out_way);                  // xyz: a ray's direction, or 0 for an entry; w: number of the lamp's leaf\n",
"#else\n",
"const bool inspected = false;\n",
"SBL_OUT(0, out_light);                // R of the part * scale, and the variance of its luminance\n",
"SBL_OUT_HARMONICS(1, 2, 3)            // spherical harmonics of the part's light * scale\n",
"#ifdef SBL_DIRECTIONAL\n",
"const bool directional = true;\n",
"#else\n",
"const bool directional = false;\n",
"#endif\n",
"#endif\n",
"const int SBL_CERTAIN = 32;         // maximum number of point lights that get one ray each\n",
"const float SBL_STRATA = 1.5;       // variance from n stratified points: SBL_STRATA / sqrt(n) times that from\n",
"                                    // independent points: measured with shadow edges on a lamp\n",
"const float SBL_STRATA_LOST = 0.6;  // upper limit of SBL_STRATA / sqrt(n), for few points per lamp\n",
"const float SBL_OPENING = 0.3;      // a cluster is one entry if its radius is below this share of its distance\n",
"const int SBL_OPENINGS = 12;        // maximum number of attempts to fit all entries; each doubles the opening\n",
"const float SBL_SPARSE = 16.0;      // a group to which a part sends fewer rays on average is `sparse`: no ratio\n",
"const int SBL_PASS_RAYS = 32;       // minimum number of rays per pass\n",
"const float SBL_PASS_CROWD = 16.0;  // maximum of (number of passes) * (effective number of entries)\n",
"const int SBL_RIM_LAMPS = 8;        // with more entries than this, none gets rim samples (rays to its edge)\n",
"const int SBL_CORNERS = 3;          // number of rim samples of a triangle, one close to each corner\n",
"const float SBL_CORNER = 0.996, SBL_OTHER_CORNER = 0.002;  // a rim sample's barycentrics: close corner, others\n",
"const int SBL_RIM = 12;             // number of rim samples of a round lamp\n",
"const float SBL_RIM_AT = 0.99;      // share of a round lamp's area inside the circle on which its rim samples lie\n",
"const float SBL_KNOWN = 1e-6;       // clusters need no more rays if variance / square of their light is below this\n",
"\n",
"int look;                    // the look that is measured: its number in the batch\n",
"uvec2 scramble;\n",
"\n",
"// >>choose\n",
"\n",
"int entries[SBL_LAMPS];      // n >= 0: lamp number n; n < 0: the cluster of node -1 - n. The first SBL_CERTAIN\n",
"                             // point lights fill the array from its end\n",
"float strengths[SBL_LAMPS];  // [i]: sum of the strengths (approximate light) of entries 0 to i\n",
"int used, certain;           // number of entries from the array's start on; number of point lights at its end\n",
"float total, crowd;          // sum of the strengths of the `used` entries; sum of their squared strengths\n",
"float crowd_within;          // estimate of what `crowd` would be if all lamps of clusters were entries\n",
"mat2x3 whole;                // by group (see sbl_Lamp): unobstructed light of lamps that are entries themselves,\n",
"                             // except texels and the `certain` point lights. Each group has its own ratio seen /\n",
"                             // open, because one side of a closed mesh hides the other\n",
"bool rounded = false;        // true: some of the lamps considered are not triangles\n",
"mat3x4 whole_harmonics[2];   // by group, as `whole`: the harmonics of that light\n",
"\n",
"// Adds node i to the entries, skips it, or descends into it. Returns the next node, or `limit`, the number of all\n",
"// nodes, if the entries are full. If all lamps fit, i and limit count leaves instead. opening: a node is one entry\n",
"// if its radius is below this share of its distance. last: true: a node of any size is one entry\n",
"int sbl_consider(int i, int limit, float opening, bool last, out bool full) {\n",
"    int leaf = i, next = i + 1, lamps = 1;\n",
"    float strength = 0.0;\n",
"    bool single = !mixed || lamp_leaves <= SBL_LAMPS, point = false;\n",
"    full = false;\n",
"    if (!single) {\n",
"        sbl_Cluster c = sbl_cluster(i);\n",
"        if (dot(n, c.to) + c.radius <= 0.0) next = c.beyond;\n",
"        else if (c.beyond == i + 1) {\n",
"            single = true;\n",
"            leaf = int(sbl_lamp_node_first_leaf(i));\n",
"        } else if (last || c.radius * c.radius < opening * opening * dot(c.to, c.to)) {\n",
"            next = c.beyond;\n",
"            lamps = (c.beyond - i + 1) / 2;\n",
"            strength = sbl_strength(i, c);\n",
"        }\n",
"    }\n",
"    if (single) {\n",
"        sbl_Lamp l = sbl_lamp(leaf);\n",
"        vec3 light = sbl_unhindered(l);\n",
"        strength = light.r + light.g + light.b;\n",
"        rounded = rounded || l.kind != SBL_LAMP_TRIANGLE;\n",
"        point = l.sine2 == 0.0 && sbl_is_light(l) && certain < SBL_CERTAIN;\n",
"        if (!point && !sbl_is_texel(l)) {\n",
"            whole += outerProduct(light, l.group);\n",
"            if (directional) whole_harmonics[l.group.y > 0.0 ? 1 : 0] += sbl_unhindered_harmonics(l);\n",
"        }\n",
"    }\n",
"    if (strength > 0.0) {\n",
"        full = used + certain == SBL_LAMPS;\n",
"        if (full) next = limit;\n",
"        else if (point) entries[SBL_LAMPS - ++certain] = leaf;\n",
"        else {\n",
"            total += strength;\n",
"            crowd += strength * strength;\n",
"            crowd_within += strength * strength / float(lamps);\n",
"            strengths[used] = total;\n",
"            entries[used++] = single ? leaf : -1 - i;\n",
"        }\n",
"    }\n",
"    return next;\n",
"}\n",
"\n",
"void sbl_choose() {\n",
"    int limit = lamp_leaves <= SBL_LAMPS ? lamp_leaves : lamp_nodes;\n",
"    float opening = SBL_OPENING;\n",
"    bool full = true;\n",
"    for (int attempt = 0; attempt < SBL_OPENINGS && full; attempt++, opening *= 2.0) {\n",
"        used = certain = 0;\n",
"        total = crowd = crowd_within = 0.0;\n",
"        whole = mat2x3(0);\n",
"        if (directional) whole_harmonics[0] = whole_harmonics[1] = mat3x4(0);\n",
"        full = false;\n",
"        for (int i = 0; i < limit; ) i = sbl_consider(i, limit, opening, attempt == SBL_OPENINGS - 1, full);\n",
"    }\n",
"}\n",
"\n",
"// >>pick\n",
"\n",
"// Picks one of the entries with a probability proportional to its strength.\n",
"int sbl_pick_entry(inout sbl_Pick p) {\n",
"    float wanted = p.u.x * total, before = 0.0;\n",
"    int low = 0, high = used - 1;\n",
"    while (low < high) {\n",
"        int middle = (low + high) / 2;\n",
"        if (strengths[middle] < wanted) { low = middle + 1; before = strengths[middle]; }\n",
"        else high = middle;\n",
"    }\n",
"    float width = strengths[low] - before;\n",
"    p.u.x = clamp((wanted - before) / width, 0.0, 1.0);\n",
"    p.share = width / total;\n",
"    return entries[low];\n",
"}\n",
"\n",
"// >>shoot\n",
"\n",
"// Sums over the rays. Light from clusters, texels and sparse groups is the mean of the rays' light; light from\n",
"// other lamps is the closed form times the ratio seen / open.\n",
"mat2x3 open = mat2x3(0), seen = mat2x3(0);    // by group: sums of the rays' light without obstruction, and with it\n",
"vec3 sure = vec3(0), sampled = vec3(0);       // sum of light of point lights; of clusters, texels, sparse groups\n",
"vec2 samples = vec2(0), lit = vec2(0);        // by group: number of rays in `open`; how many of them reached lamps\n",
"float taken = 0.0;                            // number of rays, without rim samples and rays to point lights\n",
"float squares = 0.0;                          // sum of the squared luminances of the rays in `sampled`\n",
"vec2 sparse;                                  // by group: 1: too few rays for a ratio; 0: enough\n",
"vec2 bright = vec2(0), dark = vec2(0);        // by group: number of unblocked and of blocked rays and rim samples\n",
"mat3x4 sure_harmonics = mat3x4(0), sampled_harmonics = mat3x4(0);  // harmonics of `sure` and of `sampled`\n",
"mat3x4 open_harmonics[2], seen_harmonics[2];  // harmonics of `open` and of `seen`\n",
"vec4 report = vec4(0), report_way = vec4(0);  // inspections: out_light / unit, and out_way\n",
"bool reporting;                               // true: sbl_shoot reports its ray\n",
"\n",
"// Traces the ray of a sample. at_rim: the sample only tests for obstruction; point: it is on a point light\n",
"void sbl_shoot(int slot, sbl_Pick p, sbl_Lamp l, sbl_Sample s, bool at_rim, bool point) {\n",
"    bool cluster = p.cluster || sbl_is_texel(l) || dot(sparse, l.group) > 0.0;\n",
"    vec3 light = s.light / p.share, to = s.direction;\n",
"    vec4 counts = vec4(0);\n",
"    taken += point || at_rim ? 0.0 : 1.0;\n",
"    if (!(light.r + light.g + light.b > 0.0)) return;\n",
"    if (directional) counts = sbl_harmonics(s.direction, n, 1.0 / max(dot(s.direction, n), SBL_COSINE_LEAST));\n",
"    if (!cluster && !point && !at_rim) {\n",
"        if (directional) open_harmonics[l.group.y > 0.0 ? 1 : 0] += outerProduct(counts, light);\n",
"        open += outerProduct(light, l.group);\n",
"        samples += l.group;\n",
"    }\n",
"    if (s.far < SBL_UNBOUNDED) to = s.far * s.direction + (position - stand);\n",
"    float away = s.far < SBL_UNBOUNDED ? length(to) : 1.0;\n",
"    sbl_Hit hit = sbl_trace(stand, to / away, s.far < SBL_UNBOUNDED ? away * SBL_BEFORE_LAMP : SBL_UNBOUNDED);\n",
"    bool hidden = hit.triangle >= 0 && hit.number != l.number;\n",
"#ifdef SBL_VIEWS\n",
"    hidden = hidden || sbl_hidden(slot, l, s);\n",
"#endif\n",
"    if (reporting) {\n",
"        report = vec4(point ? s.light : vec3(0), (hidden ? 2.0 : 1.0) + (point ? 1.0 : 0.0));\n",
"        report_way = vec4(point ? vec3(0) : to / away, p.leaf);\n",
"    }\n",
"    if (!point && (at_rim || !cluster)) {\n",
"        if (hidden) dark += l.group;\n",
"        else bright += l.group;\n",
"    }\n",
"    if (hidden || at_rim) return;\n",
"#ifdef SBL_TEXTURED\n",
"    if (l.kind == SBL_LAMP_TRIANGLE) {\n",
"        sbl_Attributes at = sbl_attributes_at(l.triangle, s.b.x, s.b.y);\n",
"        light *= sbl_emission_pattern(int(sbl_triangle_object(l.triangle)), at);\n",
"    }\n",
"#endif\n",
"    if (reporting && !point) report.rgb = light;\n",
"    mat3x4 harmonics = outerProduct(counts, light);\n",
"    if (directional && point) sure_harmonics += harmonics;\n",
"    else if (directional && cluster) sampled_harmonics += harmonics;\n",
"    else if (directional) seen_harmonics[l.group.y > 0.0 ? 1 : 0] += harmonics;\n",
"    if (point) sure += light;\n",
"    else if (cluster) {\n",
"        sampled += light;\n",
"        float mean = dot(light, SBL_LUMINANCE);\n",
"        squares += mean * mean;\n",
"    } else {\n",
"        seen += outerProduct(light, l.group);\n",
"        lit += l.group;\n",
"    }\n",
"}\n",
"\n",
"// >>combine\n",
"\n",
"// Variance of the mean of n rays, divided by the variance of one ray. A lamp with more rays has smaller strata.\n",
"// The variable `lamps` is the effective number of lamps, with those in clusters.\n",
"float sbl_strata(float n) {\n",
"    float lamps = total * total / max(crowd_within, 1e-37), points = max(n, 1.0);\n",
"    return min(SBL_STRATA * sqrt(max(lamps - 1.0, 1.0) / points), SBL_STRATA_LOST) / points;\n",
"}\n",
"\n",
"// Returns true if rays of a group disagree, or if the light of clusters is noisy. More rays are then needed.\n",
"bool sbl_undecided() {\n",
"    float mean = dot(sampled, SBL_LUMINANCE) / max(taken, 1.0);\n",
"    float error = squares / max(taken, 1.0) - mean * mean;\n",
"    bool disagree = dot(bright, dark) > 0.0 || (seen[0] != vec3(0) && seen[0] != open[0]) ||\n",
"                    (seen[1] != vec3(0) && seen[1] != open[1]);\n",
"    return disagree || sbl_strata(taken) * error > SBL_KNOWN * mean * mean;\n",
"}\n",
"\n",
"// Returns R * scale, and the variance of its luminance.\n",
"vec4 sbl_combine() {\n",
"    float clusters = dot(sampled, SBL_LUMINANCE) / max(taken, 1.0);\n",
"    float variance = max(squares / max(taken, 1.0) - clusters * clusters, 0.0) * sbl_strata(taken);\n",
"    vec3 light = sure + sampled / max(taken, 1.0);\n",
"    if (directional) sure_harmonics += sampled_harmonics / max(taken, 1.0);\n",
"    for (int g = 0; g < 2; g++) {\n",
"        vec3 share = mix(vec3(0), seen[g] / open[g], greaterThan(open[g], vec3(0)));\n",
"        float mean = dot(whole[g], SBL_LUMINANCE), lit_share = lit[g] / max(samples[g], 1.0);\n",
"        if (sparse[g] > 0.0) continue;\n",
"        light += whole[g] * share;\n",
"        // Harmonics: the closed form times `share`, plus the deviation from it that the rays measured.\n",
"        for (int k = 0; k < 3 && directional; k++)\n",
"            if (open[g][k] > 0.0)\n",
"                sure_harmonics[k] += share[k] * whole_harmonics[g][k] + whole[g][k] / open[g][k] *\n",
"                                     (seen_harmonics[g][k] - share[k] * open_harmonics[g][k]);\n",
"        variance += mean * mean * lit_share * (1.0 - lit_share) * sbl_strata(samples[g]);\n",
"    }\n",
"    return vec4(light, variance * unit * scale) * unit * scale;\n",
"}\n",
"\n",
"// Number of passes into which the rays are divided, a power of two. After each pass sbl_undecided decides whether\n",
"// to trace more. More lamps mean fewer passes, because each pass needs rays for all of them.\n",
"int sbl_pass_count() {\n",
"    float crowded = SBL_PASS_CROWD * crowd / max(total * total, 1e-37);\n",
"    int passes = clamp(min(rays / SBL_PASS_RAYS, int(crowded)), 1, SBL_LAMP_PASSES), power = 1;\n",
"    while (2 * power <= passes) power *= 2;\n",
"    return power;\n",
"}\n",
"\n",
"void main() {\n",
"    ivec2 at = sbl_texel_of_invocation();\n",
"    int wanted = at.y * blocks.x + at.x;  // number of the ray or, from `rays` on, of the entry to report\n",
"    int certain_ray = rays + SBL_LAMPS - 1 - wanted;  // point light to report; 0: the last of `entries`\n",
"#ifdef SBL_INSPECT\n",
"    int part = 0, slot = sheet_slot;\n",
"    if (wanted >= rays + SBL_LAMPS) sbl_leave;\n",
"    while (wanted < rays && part + 1 < parts && (part + 1) * rays / parts <= wanted) part++;\n",
"    if (wanted >= rays) part = certain_ray % parts;\n",
"    look = 0;\n",
"#else\n",
"    int parts = blocks.y, part = at.y % parts, slot = at.y / parts * columns + at.x;\n",
"    look = slot - first_slot;\n",
"    if (look < 0 || look >= count) sbl_leave;\n",
"#endif\n",
"    n = sbl_look_normal(look);\n",
"    stand = sbl_look_position(look);\n",
"    above = sbl_look_offset(look);\n",
"    position = stand - above * n;\n",
"    to_frame = transpose(sbl_frame(n));\n",
"    uint hash = sbl_look_lamp_scramble(look);\n",
"    scramble = uvec2(hash, (hash ^ hash >> 15) * 747796405u);\n",
"    scramble.y ^= scramble.y >> 13;\n",
"    sbl_choose();\n",
"    if (inspected && wanted >= rays && wanted - rays < used && entries[wanted - rays] >= 0) {\n",
"        report = vec4(sbl_unhindered(sbl_lamp(entries[wanted - rays])), 1);\n",
"        report_way.w = float(entries[wanted - rays]);\n",
"    }\n",
"    if (directional) open_harmonics[0] = open_harmonics[1] = seen_harmonics[0] = seen_harmonics[1] = mat3x4(0);\n",
"    float enough = SBL_SPARSE * float(parts) / float(rays) * total;\n",
"    sparse = vec2(lessThan(vec3(1) * whole, vec2(enough)));\n",
"    // Rim samples find shadow edges that hide only a small part of a lamp, so that more passes are made.\n",
"    int passes = sbl_pass_count(), rims = rounded ? SBL_RIM : SBL_CORNERS;\n",
"    int rim_samples = passes > 1 && used <= SBL_RIM_LAMPS ? rims * used : 0;\n",
"    int skip = int(sbl_look_which(look) & SBL_LOOK_NUMBER) * rays;\n",
"    bool undecided = total > 0.0;\n",
"    for (int pass = -1; pass < passes && (pass < 0 || undecided); pass++) {  // pass -1: rays to point lights\n",
"        // Each part has SBL_LAMP_PASSES sections of the sequence, each of which covers the unit square evenly.\n",
"        int section = SBL_LAMP_PASSES * part, sections = SBL_LAMP_PASSES * parts;\n",
"        // The divisions are unsigned, because idle lanes of some software renderers trap on INT_MIN / -1.\n",
"        int stretch = int(uint(SBL_LAMP_PASSES) / uint(passes));\n",
"        int from = int(uint((section + pass * stretch) * rays) / uint(sections));\n",
"        int to = total > 0.0 ? int(uint((section + (pass + 1) * stretch) * rays) / uint(sections)) : from;\n",
"        bool point = pass < 0;\n",
"        int start = point ? part : pass == 0 ? from - rim_samples : from, end = point ? certain : to;\n",
"        for (int k = start; k < end; k += point ? parts : 1) {\n",
"            bool at_rim = pass == 0 && k < from;\n",
"            uint rim_index = uint(from - 1 - k);\n",
"            int rim = at_rim ? int(rim_index % uint(rims)) : -1, entry = entries[point ? SBL_LAMPS - 1 - k : 0];\n",
"            uvec2 fraction = texelFetch(sbl_sequence, skip + max(k, 0)).xy ^ scramble;\n",
"            vec2 u = sbl_unit_square(fraction);\n",
"            sbl_Pick p = sbl_Pick(0, point ? 1.0 / float(parts) : 1.0, u, false);\n",
"            if (at_rim) entry = entries[rim_index / uint(rims)];\n",
"            else if (!point) entry = sbl_pick_entry(p);\n",
"            if (at_rim && entry < 0) continue;\n",
"            p.leaf = entry;\n",
"            p.cluster = entry < 0;\n",
"            if (mixed && p.cluster) sbl_descend(p, -1 - entry, fraction.x);\n",
"            sbl_Lamp l = sbl_lamp(p.leaf);\n",
"            bool corner = at_rim && l.kind == SBL_LAMP_TRIANGLE;\n",
"            if (at_rim && (sbl_is_texel(l) || (corner && rim >= SBL_CORNERS))) continue;\n",
"            float turned = float(rim) + float(scramble.y >> 8) / SBL_FRACTIONS;\n",
"            if (at_rim) p.u = vec2(SBL_RIM_AT, turned / float(SBL_RIM));\n",
"            sbl_Sample s = sbl_sample(l, p.u);\n",
"            if (corner) {\n",
"                vec3 way = l.corner + (rim == 1 ? SBL_CORNER : SBL_OTHER_CORNER) * l.side_1 +\n",
"                           (rim == 2 ? SBL_CORNER : SBL_OTHER_CORNER) * l.side_2;\n",
"                s.far = length(way);\n",
"                s.direction = way / s.far;\n",
"                s.light = vec3(dot(way, n));\n",
"            }\n",
"            reporting = inspected && (point ? k == certain_ray : !at_rim && k == wanted);\n",
"            sbl_shoot(slot, p, l, s, at_rim, point);\n",
"        }\n",
"        if (!point) undecided = sbl_undecided();\n",
"    }\n",
"#ifdef SBL_INSPECT\n",
"    sbl_write(out_light, vec4(report.rgb * unit, report.a));\n",
"    sbl_write(out_way, report_way);\n",
"#else\n",
"    sbl_write(out_light, sbl_combine());\n",
"    sure_harmonics *= unit * scale;\n",
"    sbl_write_harmonics(sure_harmonics);\n",
"#endif\n",
"}\n",
0 };
/* <<glsl */

static const sbl__recipe sbl__recipe_lamps = {
    "lamps", { sbl__glsl_fullscreen_vertex },
    { sbl__glsl_scene, sbl__glsl_frame, sbl__glsl_material, sbl__glsl_carrier, sbl__glsl_traverse, sbl__glsl_sky,
      sbl__glsl_lamp, sbl__glsl_lamps },
    { &sbl__object_record, &sbl__attributes_record, &sbl__node_record, &sbl__grid_node_record, &sbl__triangle_record,
      &sbl__look_record, &sbl__lamp_node_record, &sbl__lamp_leaf_record, &sbl__light_record_record },
    SBL__TEXTURED | SBL__CUTOUTS | SBL__WIDE | SBL__VIEWS | SBL__INSPECT | SBL__COMPUTE | SBL__MIXED |
    SBL__DIRECTIONAL
};

static unsigned sbl__aim_features(const sbl__scene *s, const sbl__spec *spec) {
    return sbl__features_of(s, spec) | (s->draw && !spec->traced ? (unsigned)SBL__VIEWS : 0) |
           (s->lights.mixed ? (unsigned)SBL__MIXED : 0);
}

/* Computes the directions of row j of a view's texels, in the frame of a look that is not rotated. `directions` has 4
   floats per texel of the padded sheet, of which the first three are a unit vector. */
static void sbl__directions_row(const sbl__layout *l, int face, int j, float *directions) {
    const int *r = l->rects[face];
    float *out = directions + 4 * ((size_t)(r[1] + j) * (size_t)sbl__layout_pitch(l, 0) + (size_t)r[0]);
    double range[4], right[3], up[3], forward[3];
    sbl__look look;
    int i, k;
    memset(&look, 0, sizeof look);
    look.normal[2] = 1;
    sbl__view_axes(&look, face, right, up, forward);
    sbl__view_range(l, face, range);
    for (i = 0; i < r[2]; i++, out += 4) {
        const double x = range[0] + (i + 0.5) * (range[1] - range[0]) / r[2];
        const double y = range[2] + (j + 0.5) * (range[3] - range[2]) / r[3], length = sqrt(1 + x * x + y * y);
        for (k = 0; k < 3; k++) out[k] = (float)((x * right[k] + y * up[k] + forward[k]) / length);
    }
}

/* ======================================================================================================== >>raster
   The back end that rasterises views, as the paper does. Only this back end shows geometry that the host draws itself.

       view    +-------+-------+    One instanced draw call draws all views of all looks of a batch, each look in its
       texture | sheet | sheet |    sheet. reduce_blocks.glsl then adds up each square of block x block texels and
               +-------+-------+    writes one texel of partial sums. */

#define SBL__SLOTS_MOST 4096   /* maximum number of slots, in both back ends (here rounded up to whole rows) */
#define SBL__STUCK_FOV 2.0f    /* field of view of a stuck test, degrees: too narrow to hit the walls of a corner */
#define SBL__STUCK_SIZE 4      /* width and height of a stuck test's view, texels */
#define SBL__STUCK_TEXTURE 512  /* maximum width and height of the part of the view texture for stuck tests, texels */

/* How a kind of look (at a site, or a stuck test) is divided into views: their directions, projections and places. */
typedef struct sbl__lens {
    sbl__layout layout;         /* positions of the views in a look's sheet */
    sbl__slots slots;           /* slots of the view texture; each holds a sheet, the views of one look */
    int area[4];                /* part of the view texture that the slots cover: 0, 0, width, height, texels */
    sbl__texture weights;       /* per texel of a sheet: form factor, and ratio of distance to depth */
    sbl__texture directions;    /* directional jobs: direction of each texel of a sheet, see sbl__directions_row */
} sbl__lens;

/* Kinds of looks: SBL__LENS_SITE measures light; SBL__LENS_STUCK (stuck tests) looks from a sensor at its surface. */
enum { SBL__LENS_SITE, SBL__LENS_STUCK, SBL__LENSES };

typedef struct sbl__raster {
    sbl__lens lenses[SBL__LENSES];
    sbl__texture view_texture, depth;
    sbl__target target;
    sbl__buffer views;
    float radiance_scale;      /* value in the view texture / radiance */
    float *weights, *directions;  /* texels of a lens's two textures while sbl__raster_weigh computes them */
    int face, row;             /* view and row at which sbl__raster_weigh continues */
} sbl__raster;

static void sbl__raster_free(const sbl__device *d, sbl__raster *r) {
    int i;
    for (i = 0; i < SBL__LENSES; i++) {
        sbl__texture_delete(d, &r->lenses[i].weights);
        sbl__texture_delete(d, &r->lenses[i].directions);
    }
    sbl__target_delete(d, &r->target);
    sbl__texture_delete(d, &r->view_texture);
    sbl__texture_delete(d, &r->depth);
    sbl__buffer_delete(d, &r->views);
    sbl__free(d->base, r->weights);
    sbl__free(d->base, r->directions);
}

/* Computes the slots of a lens in a square view texture of size view_texture_size, or larger if one sheet needs more,
   up to the driver's limit `most`. If the limit is too small for a sheet, there are 0 slots. */
static void sbl__lens_fit(sbl__lens *lens, int view_texture_size, int most) {
    const sbl__layout *l = &lens->layout;
    const int pitch[2] = { sbl__layout_pitch(l, 0), sbl__layout_pitch(l, 1) };
    const int size = SBL__MIN(SBL__MAX(view_texture_size, SBL__MAX(pitch[0], pitch[1])), most);
    const int columns = size / pitch[0];
    int rows = size / pitch[1];
    if (columns > 0) rows = SBL__MIN(rows, (SBL__SLOTS_MOST + columns - 1) / columns);
    memcpy(lens->slots.blocks, l->blocks, sizeof l->blocks);
    lens->slots.columns = columns;
    lens->slots.count = columns * rows;
    lens->area[2] = columns * pitch[0];
    lens->area[3] = rows * pitch[1];
}

/* Makes the view texture, and computes the slots of looks and of stuck tests in it. */
static sbl_result sbl__raster_setup(const sbl__device *d, sbl__raster *r, const sbl__scene *scene,
                                    const sbl__spec *spec, sbl__blocks *blocks) {
    const int most = d->gl.capabilities.max_texture_size;
    sbl__lens *lens = &r->lenses[SBL__LENS_SITE], *stuck = &r->lenses[SBL__LENS_STUCK];
    float brightest;
    int size[2], sums[2], k;
    sbl_result result;
    sbl__layout_make(&lens->layout, spec->hemicube, spec->size, spec->fov);
    sbl__layout_make(&stuck->layout, 0, SBL__STUCK_SIZE, SBL__STUCK_FOV);
    sbl__lens_fit(lens, spec->view_texture_size, most);
    sbl__lens_fit(stuck, SBL__MIN(spec->view_texture_size, SBL__STUCK_TEXTURE), most);
    if (lens->slots.count < 1) {
        sbl__log(d->base, SBL_LOG_ERROR, SBL_LOG_ITEM_TOO_LARGE, "a sensor of size %d needs a texture of %d x %d, but "
                 "the driver's limit is %d; use a smaller sensor_size", spec->size, sbl__layout_pitch(&lens->layout, 0),
                 sbl__layout_pitch(&lens->layout, 1), most);
        return SBL_ERROR_UNSUPPORTED;
    }
    for (k = 0; k < 2; k++) {
        size[k] = SBL__MAX(lens->area[2 + k], stuck->area[2 + k]);
        sums[k] = SBL__MAX(lens->area[2 + k] / lens->layout.block, stuck->area[2 + k] / stuck->layout.block);
    }
    brightest = SBL__MAX(scene->brightest, spec->bounced ? scene->store.brightest : spec->epsilon);
    for (k = 0; k < 6 && spec->bounced; k++) brightest = SBL__MAX(brightest, sbl__max3(scene->store.air[k]));
    r->radiance_scale = 1;  /* power of two that scales the brightest radiance to 512 .. 1024, for 16-bit floats */
    if (brightest > 0) r->radiance_scale = (float)ldexp(1, SBL__MIN(10 - (int)ceil(log(brightest) / log(2.0)), 100));
    r->face = r->row = 0;
    result = sbl__texture_make(d, &r->view_texture, size[0], size[1], SBL__GL_RGBA16F);
    if (result == SBL_SUCCESS) result = sbl__texture_make(d, &r->depth, size[0], size[1], SBL__GL_DEPTH_COMPONENT32F);
    if (result == SBL_SUCCESS) result = sbl__target_make(d, &r->target, &r->view_texture, 1, &r->depth);
    return result == SBL_SUCCESS ? sbl__blocks_make(d, blocks, spec->directional ? 5 : 2, sums[0], sums[1]) : result;
}

/* Computes the textures of a lens, row by row. Returns SBL_UNFINISHED if the slice ends before they are complete. */
static sbl_result sbl__raster_weigh(const sbl__device *d, sbl__raster *r, sbl__lens *lens, const sbl__spec *spec,
                                    const sbl__slice *slice) {
    const sbl__layout *l = &lens->layout;
    const int width = sbl__layout_pitch(l, 0), height = sbl__layout_pitch(l, 1);
    const int paper = spec->paper && lens == &r->lenses[SBL__LENS_SITE];
    sbl_result result;
    if (!r->weights) r->weights = (float *)sbl__alloc(d->base, (size_t)width * (size_t)height, 8);
    if (!r->directions && spec->directional)
        r->directions = (float *)sbl__alloc(d->base, (size_t)width * (size_t)height, 16);
    if (!r->weights || (spec->directional && !r->directions)) return SBL_ERROR_OUT_OF_MEMORY;
    for (; r->face < l->view_count; r->face++, r->row = 0)
        while (r->row < l->rects[r->face][3]) {
            if (spec->directional) sbl__directions_row(l, r->face, r->row, r->directions);
            sbl__weights_row(l, paper, r->face, r->row++, r->weights);
            if (sbl__now() >= slice->end) return SBL_UNFINISHED;
        }
    result = sbl__texture_make(d, &lens->weights, width, height, SBL__GL_RG32F);
    if (result == SBL_SUCCESS) result = sbl__texture_write(d, &lens->weights, 0, height, r->weights);
    if (result == SBL_SUCCESS && spec->directional) {
        result = sbl__texture_make(d, &lens->directions, width, height, SBL__GL_RGBA32F);
        if (result == SBL_SUCCESS) result = sbl__texture_write(d, &lens->directions, 0, height, r->directions);
    }
    sbl__free(d->base, r->weights);
    sbl__free(d->base, r->directions);
    r->weights = r->directions = NULL;
    r->face = r->row = 0;
    return result;
}

/* >>raster: drawing */

/* >>glsl sensor_vertex: shaders_embedded/sensor_vertex.glsl, copied by scripts/embed_shaders */
static const char *const sbl__glsl_sensor_vertex[] = {
"// Draws the scene into views of many sensors. Each instance is a view, clipped to its part of the view texture.\n",
"layout(location = 0) in vec3 position;\n",
"layout(location = 1) in uint object;\n",
"layout(location = 2) in vec2 vertex_uv;\n",
"layout(location = 3) in uvec2 vertex_color;\n",
"layout(location = 4) in vec3 view_eye;      // position of the sensor\n",
"layout(location = 5) in vec4 view_right;    // unit vector to the right / tan(fov / 2); w: scale of x in clip space\n",
"layout(location = 6) in vec4 view_up;       // unit vector up / tan(fov / 2); w: scale of y in clip space\n",
"layout(location = 7) in vec4 view_forward;  // unit vector; w: lowest y: -1, or 0 if the view begins at the horizon\n",
"layout(location = 8) in vec2 view_offset;   // normalised device coordinates of the view's forward axis\n",
"uniform float per_length;                   // 1 / extent of the scene\n",
"uniform float radiance_scale;\n",
"out vec3 place;                             // x, y and w of gl_Position\n",
"flat out int fragment_object;               // only with SBL_TEXTURED or SBL_BOUNCED\n",
"flat out vec3 radiance_front, radiance_back;  // only if neither SBL_TEXTURED nor SBL_BOUNCED is defined\n",
"out vec2 fragment_uv;                       // only with SBL_TEXTURED, like fragment_color\n",
"out vec4 fragment_color;\n",
"out vec3 fragment_way;                      // only with SBL_BOUNCED: vector from the sensor to the surface\n",
"out vec3 fragment_place;                    // only with SBL_BOUNCED: point on the surface, world space\n",
"\n",
"void main() {\n",
"    int number = int(object);\n",
"#ifdef SBL_BOUNCED\n",
"    fragment_way = position - view_eye;\n",
"    fragment_place = position;\n",
"#endif\n",
"#ifdef SBL_TEXTURED\n",
"    fragment_uv = vertex_uv;\n",
"    fragment_color = sbl_unpack_color(vertex_color.x, vertex_color.y) / SBL_COLOR_MOST;\n",
"#endif\n",
"#if defined(SBL_TEXTURED) || defined(SBL_BOUNCED)\n",
"    fragment_object = number;\n",
"#else\n",
"    radiance_front = radiance_scale * sbl_outgoing(number, false, SBL_PLAIN);\n",
"    radiance_back = radiance_scale * sbl_outgoing(number, true, SBL_PLAIN);\n",
"#endif\n",
"    vec3 p = (position - view_eye) * per_length;\n",
"    float x = dot(view_right.xyz, p), y = dot(view_up.xyz, p), w = dot(view_forward.xyz, p);\n",
"    gl_Position = vec4(x * view_right.w + w * view_offset.x, y * view_up.w + w * view_offset.y, SBL_VIEW_DEPTH, w);\n",
"    place = gl_Position.xyw;\n",
"    gl_ClipDistance[0] = w + x;\n",
"    gl_ClipDistance[1] = w - x;\n",
"    gl_ClipDistance[2] = y - w * view_forward.w;\n",
"    gl_ClipDistance[3] = w - y;\n",
"    if ((sbl_object_flags(number) & SBL_HIDDEN_FROM_SENSORS) != 0u) gl_ClipDistance[0] = -1.0;\n",
"}\n",
0 };
/* <<glsl */

/* >>glsl sensor_fragment: shaders_embedded/sensor_fragment.glsl, copied by scripts/embed_shaders */
static const char *const sbl__glsl_sensor_fragment[] = {
"// Writes a texel of a sensor's view.\n",
"layout(location = 0) out vec4 out_radiance;  // radiance towards the sensor (Ck of the paper);\n",
"                                             // distance along the view's axis, negative for a back face\n",
"in vec3 place;                               // x, y and w of the position in clip space\n",
"uniform vec2 view_texture_size;              // texels\n",
"uniform float radiance_scale;\n",
"uniform int first_triangle;                  // number of the first triangle of the draw call\n",
"flat in int fragment_object;\n",
"flat in vec3 radiance_front, radiance_back;\n",
"in vec2 fragment_uv;\n",
"in vec4 fragment_color;\n",
"in vec3 fragment_way, fragment_place;\n",
"\n",
"const float SBL_NEAREST = 3e-8;  // smallest visible distance along a view's axis, in extents of the scene\n",
"const float SBL_BESIDE = 0.4;    // maximum distance between gl_FragCoord and the interpolated `place`, texels\n",
"const float SBL_BESIDE_ROUNDING = 3e-7;  // added to SBL_BESIDE * place.z for rounding\n",
"\n",
"// Returns false for fragments at wrong places. The projection of a triangle whose plane contains the sensor is a\n",
"// line; rounding may turn the line into a triangle anywhere, even in the views of other sensors.\n",
"bool sbl_seen_here() {\n",
"    vec2 at = gl_FragCoord.xy / view_texture_size * 2.0 - 1.0;\n",
"    vec2 beside = abs(place.xy - at * place.z) * 0.5 * view_texture_size;\n",
"    return place.z > SBL_NEAREST && max(beside.x, beside.y) <= SBL_BESIDE * place.z + SBL_BESIDE_ROUNDING;\n",
"}\n",
"\n",
"void main() {\n",
"    if (!sbl_seen_here()) discard;\n",
"#ifdef SBL_TEXTURED\n",
"    sbl_Attributes at = sbl_Attributes(fragment_uv, fragment_color);\n",
"    if (sbl_has_holes(fragment_object) && sbl_material(fragment_object, at).cut_out) discard;\n",
"#else\n",
"    sbl_Attributes at = SBL_PLAIN;\n",
"#endif\n",
"#if defined(SBL_TEXTURED) || defined(SBL_BOUNCED)\n",
"    vec3 radiance = sbl_outgoing(fragment_object, !gl_FrontFacing, at) * radiance_scale;\n",
"#else\n",
"    vec3 radiance = gl_FrontFacing ? radiance_front : radiance_back;\n",
"#endif\n",
"#ifdef SBL_BOUNCED\n",
"    vec3 light = sbl_stored(first_triangle + gl_PrimitiveID, !gl_FrontFacing, fragment_place,\n",
"                            length(fragment_way));\n",
"    radiance += radiance_scale * sbl_reflected(sbl_material(fragment_object, at), light);\n",
"#endif\n",
"    out_radiance = vec4(radiance, gl_FrontFacing ? 1.0 / gl_FragCoord.w : -1.0 / gl_FragCoord.w);\n",
"#ifdef SBL_WRITE_DEPTH\n",
"    gl_FragDepth = SBL_VIEW_DEPTH * gl_FragCoord.w;\n",
"#endif\n",
"}\n",
0 };
/* <<glsl */

static const sbl__recipe sbl__recipe_sensor = {
    "sensor", { sbl__glsl_scene, sbl__glsl_frame, sbl__glsl_material, sbl__glsl_sensor_vertex },
    { sbl__glsl_scene, sbl__glsl_frame, sbl__glsl_material, sbl__glsl_store, sbl__glsl_sensor_fragment },
    { &sbl__object_record, &sbl__cut_record, &sbl__leaf_record },
    SBL__TEXTURED | SBL__WIDE | SBL__WRITE_DEPTH | SBL__BOUNCED
};

/* >>glsl sky_vertex: shaders_embedded/sky_vertex.glsl, copied by scripts/embed_shaders */
static const char *const sbl__glsl_sky_vertex[] = {
"// Draws the environment's picture as the background of the views of many sensors. Each instance covers the\n",
"// rectangle of one view. The attributes are those of sensor_vertex.glsl.\n",
"layout(location = 5) in vec4 view_right;\n",
"layout(location = 6) in vec4 view_up;\n",
"layout(location = 7) in vec4 view_forward;\n",
"layout(location = 8) in vec2 view_offset;\n",
"out vec3 direction;\n",
"\n",
"void main() {\n",
"    float x = gl_VertexID % 2 == 0 ? -1.0 : 1.0, y = gl_VertexID < 2 ? view_forward.w : 1.0;\n",
"    direction = view_forward.xyz + x / dot(view_right.xyz, view_right.xyz) * view_right.xyz +\n",
"                y / dot(view_up.xyz, view_up.xyz) * view_up.xyz;\n",
"    gl_Position = vec4(x * view_right.w + view_offset.x, y * view_up.w + view_offset.y, 0, 1);\n",
"}\n",
0 };
/* <<glsl */

/* >>glsl sky_fragment: shaders_embedded/sky_fragment.glsl, copied by scripts/embed_shaders */
static const char *const sbl__glsl_sky_fragment[] = {
"in vec3 direction;\n",
"uniform float radiance_scale;\n",
"layout(location = 0) out vec4 out_radiance;  // a: distance as in sensor_fragment.glsl; 0: no surface\n",
"\n",
"void main() { out_radiance = vec4(radiance_scale * sbl_sky(direction), 0); }\n",
0 };
/* <<glsl */

static const sbl__recipe sbl__recipe_sky = {
    "sky", { sbl__glsl_sky_vertex }, { sbl__glsl_sky, sbl__glsl_sky_fragment }, { NULL }, 0
};

static const sbl__input sbl__view_inputs[] = {
    { 4, 3, SBL__GL_FLOAT, 0, 1, sizeof(sbl__view), offsetof(sbl__view, eye) },
    { 5, 4, SBL__GL_FLOAT, 0, 1, sizeof(sbl__view), offsetof(sbl__view, right) },
    { 6, 4, SBL__GL_FLOAT, 0, 1, sizeof(sbl__view), offsetof(sbl__view, up) },
    { 7, 4, SBL__GL_FLOAT, 0, 1, sizeof(sbl__view), offsetof(sbl__view, forward) },
    { 8, 2, SBL__GL_FLOAT, 0, 1, sizeof(sbl__view), offsetof(sbl__view, offset) }
};

/* Fills at least the first `slots` slots, in whole rows, with sbl_scene_desc.sky. A picture of the sky is added
   later. */
static void sbl__raster_clear(const sbl__device *d, const sbl__raster *r, const sbl__lens *lens,
                              const sbl__scene *scene, int slots) {
    const int rows = (slots + lens->slots.columns - 1) / lens->slots.columns;
    const int used[4] = { 0, 0, lens->area[2], rows * sbl__layout_pitch(&lens->layout, 1) };
    float sky[4] = { 0, 0, 0, 0 };
    int k;
    for (k = 0; k < 3; k++) sky[k] = scene->environment.sky[k] * r->radiance_scale;
    sbl__pass(d, &r->target, NULL, used, 0);
    sbl__clear(d, sky);
}

/* Gets the lowest x and y of a slot's sheet in the view texture, texels. */
static void sbl__raster_corner(const sbl__lens *lens, int slot, int corner[2]) {
    corner[0] = slot % lens->slots.columns * sbl__layout_pitch(&lens->layout, 0);
    corner[1] = slot / lens->slots.columns * sbl__layout_pitch(&lens->layout, 1);
}

static sbl_result sbl__raster_send(const sbl__device *d, sbl__raster *r, const sbl__lens *lens, const sbl__batch *b) {
    const sbl__layout *l = &lens->layout;
    const size_t count = (size_t)b->count * (size_t)l->view_count;
    const size_t room = (size_t)lens->slots.count * (size_t)l->view_count;
    sbl__view *views = (sbl__view *)sbl__alloc_raw(d->base, count, sizeof *views);
    sbl_result result;
    int i, face, corner[2];
    if (!views) return SBL_ERROR_OUT_OF_MEMORY;
    for (i = 0; i < b->count; i++)
        for (face = 0; face < l->view_count; face++) {
            sbl__raster_corner(lens, b->slot + i, corner);
            sbl__view_make(l, &b->looks[i], face, corner, lens->area + 2, &views[i * l->view_count + face]);
        }
    result = sbl__buffer_stream(d, &r->views, room * sizeof *views, views, count * sizeof *views);
    sbl__free(d->base, views);
    return result;
}

/* Fills the description of a view that the host's draw callback receives. number: index of the view in the batch */
static void sbl__raster_view(const sbl__raster *r, const sbl__lens *lens, const sbl__batch *b, int number,
                             sbl_draw_view *v) {
    const sbl__layout *l = &lens->layout;
    const int i = number / l->view_count, face = number % l->view_count, *rect = l->rects[face];
    const sbl__look *look = &b->looks[i];
    const double per_length = 1 / (double)b->scene->geometry.extent;
    double right[3], up[3], forward[3];
    int corner[2], k;
    memset(v, 0, sizeof *v);
    sbl__raster_corner(lens, b->slot + i, corner);
    v->kind = SBL_VIEW_SENSOR;
    for (k = 0; k < 4; k++) v->viewport[k] = rect[k] + (k < 2 ? corner[k] : 0);
    sbl__view_axes(look, face, right, up, forward);
    for (k = 0; k < 3; k++) {
        v->world_to_view[4 * k] = (float)right[k];
        v->world_to_view[4 * k + 1] = (float)up[k];
        v->world_to_view[4 * k + 2] = (float)-forward[k];
        v->world_to_view[12] -= (float)(right[k] * look->position[k]);
        v->world_to_view[13] -= (float)(up[k] * look->position[k]);
        v->world_to_view[14] += (float)(forward[k] * look->position[k]);
        v->eye[k] = look->position[k];
    }
    v->world_to_view[15] = 1;
    v->view_to_clip[0] = (float)(per_length / l->tangent);
    v->view_to_clip[5] = (float)(per_length / l->tangent) * (face ? 2.0f : 1.0f);
    v->view_to_clip[9] = face ? (float)per_length : 0.0f;  /* side views of a hemicube cover y from 0 to 1 only */
    v->view_to_clip[11] = (float)-per_length;
    v->view_to_clip[14] = SBL__VIEW_DEPTH;
    v->radiance_scale = r->radiance_scale;
    v->depth_scale = SBL__VIEW_DEPTH;
    v->epsilon = b->spec->epsilon;
    for (k = 0; k < 18; k++) v->light[k / 3][k % 3] = v->epsilon;
    if (b->spec->bounced) memcpy(v->light, b->scene->store.air, sizeof v->light);
    v->sensor = b->first + i;
    v->face = face;
}

/* Draws the environment's picture. The scene's vertex array has the attributes of the views already. */
static sbl_result sbl__raster_sky(sbl__device *d, const sbl__raster *r, const sbl__lens *lens, const sbl__batch *b) {
    const sbl_result result = sbl__use(d, &sbl__recipe_sky, b->scene->features);
    if (result != SBL_SUCCESS) return result;
    sbl__pass(d, &r->target, lens->area, NULL, 0);
    sbl__environment_bind(d, &b->scene->environment);
    sbl__set_float(d, "radiance_scale", r->radiance_scale);
    sbl__draw_rectangles(d, b->scene->geometry.vertex_array, b->count * lens->layout.view_count);
    return SBL_SUCCESS;
}

/* Draws the triangles first .. end - 1 of the scene to all views of a batch. The call with the first triangle also
   draws the environment. The call with the last triangle also calls the host's draw callback for each view. */
static sbl_result sbl__raster_draw(sbl__device *d, sbl__raster *r, const sbl__lens *lens, const sbl__batch *b,
                                   int first, int end) {
    const sbl__geometry *g = &b->scene->geometry;
    const int views = b->count * lens->layout.view_count;
    sbl_result result = SBL_SUCCESS;
    sbl_draw_view view;
    int i;
    if (first == 0) result = sbl__raster_send(d, r, lens, b);
    if (result != SBL_SUCCESS) return result;
    sbl__array_inputs(d, g->vertex_array, &r->views, sbl__view_inputs, SBL__COUNT(sbl__view_inputs));
    if (first == 0 && b->scene->environment.pixels && !b->spec->paper) result = sbl__raster_sky(d, r, lens, b);
    if (result == SBL_SUCCESS && end > first) {
        result = sbl__use(d, &sbl__recipe_sensor, sbl__features_of(b->scene, b->spec));
        if (result != SBL_SUCCESS) return result;
        sbl__pass(d, &r->target, lens->area, NULL, SBL__PASS_DEPTH | SBL__PASS_CLIP);
        sbl__scene_bind(d, b->scene);
        sbl__set_int(d, "lamps_apart", !b->spec->paper);
        sbl__set_float(d, "per_length", 1 / g->extent);
        sbl__set_float(d, "epsilon", b->spec->epsilon);
        sbl__set_float(d, "radiance_scale", r->radiance_scale);
        sbl__set_vec2(d, "view_texture_size", (float)lens->area[2], (float)lens->area[3]);
        sbl__set_int(d, "first_triangle", first);
        if (b->spec->bounced) sbl__store_bind(d, &b->scene->store);
        sbl__draw_mesh(d, g->vertex_array, first, end - first, views);
    }
    for (i = 0; i < views && b->scene->draw && end == g->triangle_count && result == SBL_SUCCESS; i++) {
        sbl__raster_view(r, lens, b, i, &view);
        sbl__host_draw(d, &r->target, b->scene->draw, &view, b->scene->draw_user);
    }
    return result;
}

/* Gives lamps.glsl access to the views. Geometry that the host draws may hide a lamp, and only views show it. */
static void sbl__raster_bind(sbl__device *d, const sbl__raster *r, float extent) {
    const sbl__layout *l = &r->lenses[SBL__LENS_SITE].layout;
    int i, k;
    sbl__bind(d, "view_texture", &r->view_texture);
    for (i = 0; i < l->view_count; i++) {
        char name[32];
        float rect[4];
        snprintf(name, sizeof name, "view_rects[%d]", i);
        for (k = 0; k < 4; k++) rect[k] = (float)l->rects[i][k];
        sbl__set_vec4(d, name, rect);
    }
    sbl__set_ints(d, "sheet", sbl__layout_pitch(l, 0), sbl__layout_pitch(l, 1));
    sbl__set_int(d, "view_count", l->view_count);
    sbl__set_float(d, "tangent", (float)l->tangent);
    sbl__set_float(d, "extent", extent);
}

/* >>glsl reduce_blocks: shaders_embedded/reduce_blocks.glsl, copied by scripts/embed_shaders */
static const char *const sbl__glsl_reduce_blocks[] = {
"// First step of the sum over a sensor's views: each output texel is the sum over one block of the view texture.\n",
"uniform sampler2D view_texture;  // written by sensor_fragment.glsl\n",
"uniform sampler2D weights;       // per texel of a sheet: form factor; ratio of distance to depth\n",
"uniform int block;               // width and height of a block, texels\n",
"SBL_OUT(0, out_sum);             // sum of weight * radiance; sum of the weights of back faces\n",
"SBL_OUT(1, out_hits);            // surfaces: sum of weights; sum of weight * distance; least distance; 0\n",
"uniform sampler2D directions;    // SBL_DIRECTIONAL: direction of each texel of a sheet, for a look of rotation 0\n",
"SBL_OUT_HARMONICS(2, 3, 4)\n",
"\n",
"void main() {\n",
"    ivec2 at = ivec2(gl_FragCoord.xy), corner = at * block, sheet_corner = (at % blocks) * block;\n",
"    vec4 sum = vec4(0), hits = vec4(0, 0, SBL_UNBOUNDED, 0);\n",
"    int slot = at.y / blocks.y * columns + at.x / blocks.x;\n",
"    float s = sin(sbl_look_rotation(slot)), c = cos(sbl_look_rotation(slot));\n",
"    mat3 frame = sbl_frame(sbl_look_normal(slot)) * mat3(c, -s, 0, s, c, 0, 0, 0, 1);\n",
"    mat3x4 harmonics = mat3x4(0);\n",
"    for (int y = 0; y < block; y++) {\n",
"        vec3 row = vec3(0);\n",
"        float back = 0.0;\n",
"        for (int x = 0; x < block; x++) {\n",
"            vec4 texel = texelFetch(view_texture, corner + ivec2(x, y), 0);\n",
"            vec2 weight = texelFetch(weights, sheet_corner + ivec2(x, y), 0).xy;\n",
"            row += weight.x * texel.rgb;\n",
"            vec3 way = texelFetch(directions, sheet_corner + ivec2(x, y), 0).xyz;\n",
"            vec4 counts = sbl_harmonics(frame * way, frame[2], 1.0 / max(way.z, SBL_COSINE_LEAST));\n",
"            harmonics += outerProduct(counts, weight.x * texel.rgb);\n",
"            float seen = weight.x > 0.0 && texel.a != 0.0 ? weight.x : 0.0;\n",
"            float length_to_hit = abs(texel.a) * weight.y;\n",
"            back += texel.a < 0.0 ? seen : 0.0;\n",
"            hits.x += seen;\n",
"            hits.y += seen * min(length_to_hit, SBL_UNBOUNDED);\n",
"            hits.z = seen > 0.0 ? min(hits.z, length_to_hit) : hits.z;\n",
"        }\n",
"        sum += vec4(row, back);\n",
"    }\n",
"    out_sum = sum;\n",
"    out_hits = hits;\n",
"    sbl_write_harmonics(harmonics);\n",
"}\n",
0 };
/* <<glsl */

static const sbl__recipe sbl__recipe_reduce_blocks = {
    "reduce_blocks", { sbl__glsl_fullscreen_vertex }, { sbl__glsl_frame, sbl__glsl_carrier, sbl__glsl_reduce_blocks },
    { &sbl__look_record }, SBL__DIRECTIONAL
};

/* Computes the partial sums of rows[1] rows of slots from row rows[0] on. looks: NULL if the job is not directional */
static sbl_result sbl__raster_reduce(sbl__device *d, const sbl__raster *r, const sbl__lens *lens, const sbl__blocks *b,
                                     const sbl__table *looks, const int rows[2]) {
    const sbl__layout *l = &lens->layout;
    const sbl_result result = sbl__use(d, &sbl__recipe_reduce_blocks, looks ? (unsigned)SBL__DIRECTIONAL : 0);
    const int area[4] = { 0, rows[0] * l->blocks[1], lens->slots.columns * l->blocks[0], rows[1] * l->blocks[1] };
    if (result != SBL_SUCCESS) return result;
    sbl__pass(d, &b->target, area, NULL, 0);
    sbl__bind(d, "view_texture", &r->view_texture);
    sbl__bind(d, "weights", &lens->weights);
    if (looks) {
        sbl__bind(d, "directions", &lens->directions);
        sbl__bind_table(d, "sbl_looks", looks);
        sbl__set_int(d, "columns", lens->slots.columns);
    }
    sbl__set_int(d, "block", l->block);
    sbl__set_ints(d, "blocks", l->blocks[0], l->blocks[1]);
    sbl__draw_screen(d);
    return SBL_SUCCESS;
}

/* ======================================================================================================== >>trace
   The back end that traces rays over the hemisphere. A ray's cost grows with the logarithm of the triangle count. */

#define SBL__TRACE_CHUNK 16        /* maximum number of rays per invocation */
#define SBL__TRACE_COLUMNS 256     /* maximum number of looks side by side in the textures of partial sums */
#define SBL__TRACE_TEXELS 1024     /* maximum width and height of the textures of partial sums, texels */

typedef struct sbl__trace {
    sbl__slots slots[SBL__LENSES]; /* slots in the partial sums: for looks at sites; for stuck tests, one ray each */
    sbl__table sequence;           /* points that give the rays' directions, see sbl__sequence_make */
} sbl__trace;

static sbl_result sbl__trace_setup(const sbl__device *d, sbl__trace *t, const sbl__scene *scene, const sbl__spec *spec,
                                   sbl__blocks *blocks) {
    const int most = SBL__MIN(SBL__TRACE_CHUNK, SBL__MAX(1, sbl__rays_most(&scene->hierarchy) / 4));
    const int chunk = SBL__MIN(most, (spec->rays + 7) / 8);
    const int chunks = (spec->rays + chunk - 1) / chunk, parts = sbl__aim_parts(spec, &scene->hierarchy);
    sbl__slots *s = &t->slots[SBL__LENS_SITE], *stuck = &t->slots[SBL__LENS_STUCK];
    sbl_result result;
    int rows;
    s->blocks[0] = SBL__MIN(chunks, 4);
    s->blocks[1] = (chunks + 3) / 4;
    s->columns = SBL__MIN(SBL__TRACE_TEXELS, d->gl.capabilities.max_texture_size) / s->blocks[0];
    s->columns = SBL__MAX(1, SBL__MIN(SBL__TRACE_COLUMNS, s->columns));
    rows = SBL__MIN(SBL__TRACE_TEXELS / SBL__MAX(s->blocks[1], parts), SBL__SLOTS_MOST / s->columns);
    rows = SBL__MAX(1, rows);
    s->count = s->columns * rows;
    *stuck = *s;
    stuck->blocks[0] = stuck->blocks[1] = 1;
    result = sbl__sequence_store(d, &t->sequence, spec->looks, spec->rays, 1);
    return result == SBL_SUCCESS ? sbl__blocks_make(d, blocks, spec->directional ? 6 : 2, s->columns * s->blocks[0],
                                                    rows * s->blocks[1]) : result;
}

/* >>glsl guide: shaders_embedded/guide.glsl, copied by scripts/embed_shaders */
static const char *const sbl__glsl_guide[] = {
"// Distributes a sensor's rays by a guide (see >>guide in sbl.h). A guide divides 0 .. 65536 into SBL_GUIDE_RINGS\n",
"// intervals, one per ring of the hemisphere, and for each ring into SBL_GUIDE_SECTORS intervals, one per sector.\n",
"// It stores the beginning of each interval as a 16-bit number, eight of them per texel.\n",
"#ifdef SBL_GUIDED\n",
"uniform usampler2D sbl_guides;\n",
"\n",
"// Finds the interval that contains x, among the 8 * texels intervals that are stored from texel `from` on. Returns\n",
"// its beginning, its end and its index.\n",
"vec3 sbl_guide_interval(ivec2 from, int texels, float x) {\n",
"    vec3 at = vec3(0, SBL_GUIDE_STEPS, -1);\n",
"    for (int i = 0; i < texels; i++) {\n",
"        uvec4 eight = texelFetch(sbl_guides, from + ivec2(i, 0), 0);\n",
"        vec4 a = vec4(eight & 0xffffu), b = vec4(eight >> 16);\n",
"        vec4 begun_a = step(a, vec4(x)), begun_b = step(b, vec4(x));\n",
"        vec4 last = max(a * begun_a, b * begun_b);\n",
"        vec4 end = vec4(SBL_GUIDE_STEPS), next = min(mix(end, a, 1.0 - begun_a), mix(end, b, 1.0 - begun_b));\n",
"        at.x = max(at.x, max(max(last.x, last.y), max(last.z, last.w)));\n",
"        at.y = min(at.y, min(min(next.x, next.y), min(next.z, next.w)));\n",
"        at.z += dot(begun_a + begun_b, vec4(1));\n",
"    }\n",
"    return at;\n",
"}\n",
"\n",
"// Maps a uniform point u of the unit square to one that is distributed by the guide. Returns the weight of its\n",
"// ray: the inverse of the point's density, so that the expected value of the ray's light does not change.\n",
"float sbl_guide(int guide, inout vec2 u) {\n",
"    const int ring_texels = SBL_GUIDE_RINGS / 8, sector_texels = SBL_GUIDE_SECTORS / 8;\n",
"    const vec2 counts = vec2(SBL_GUIDE_RINGS, SBL_GUIDE_SECTORS);\n",
"    ivec2 from = ivec2(guide % SBL_GUIDES_ACROSS * SBL_GUIDE_TEXELS, guide / SBL_GUIDES_ACROSS);\n",
"    vec2 x = u * SBL_GUIDE_STEPS;\n",
"    vec3 ring = sbl_guide_interval(from, ring_texels, x.x);\n",
"    from.x += ring_texels + int(ring.z) * sector_texels;\n",
"    vec3 sector = sbl_guide_interval(from, sector_texels, x.y);\n",
"    vec2 begins = vec2(ring.x, sector.x), widths = vec2(ring.y, sector.y) - begins;\n",
"    u = (vec2(ring.z, sector.z) + (x - begins) / widths) / counts;\n",
"    return SBL_GUIDE_STEPS / (widths.x * counts.x) * (SBL_GUIDE_STEPS / (widths.y * counts.y));\n",
"}\n",
"#endif\n",
0 };
/* <<glsl */

/* >>glsl trace: shaders_embedded/trace.glsl, copied by scripts/embed_shaders */
static const char *const sbl__glsl_trace[] = {
"// Traces a part of a look's rays over the hemisphere, whose directions have a cosine distribution, and sums them.\n",
"// The outputs are those of reduce_blocks.glsl; out_hits.w is the variance of the luminance.\n",
"uniform usamplerBuffer sbl_sequence;  // Sobol points along a Morton curve, two 32-bit fractions each\n",
"uniform int rays;                     // number of rays per look\n",
"uniform int paired;                   // 1: an invocation traces pairs of rays; 0: single ones\n",
"uniform bool no_light;                // true: only distances are wanted: only a site's first look traces rays\n",
"uniform float spread;                 // 1: over the whole hemisphere; 0: all rays along the normal\n",
"uniform float distance_limit;         // larger distances of hits count as this distance in the mean\n",
"SBL_OUT(0, out_sum);\n",
"SBL_OUT(1, out_hits);\n",
"SBL_OUT_HARMONICS(2, 3, 4)\n",
"#ifdef SBL_DIRECTIONAL\n",
"SBL_OUT(5, out_even);                 // control variate for radiance 1 from everywhere: the exact harmonics minus\n",
"                                      // those that these rays measure; reduce_sum.glsl adds it, times the mean\n",
"                                      // radiance, to the measured harmonics\n",
"#endif\n",
"\n",
"const float SBL_NEIGHBOURS = 0.62;  // measured variance / its estimate from pairs, at 16 to 256 rays\n",
"\n",
"// Radiance that leaves a hit towards the ray's origin. goes_on: set to true if the hit is near. The radiance then\n",
"// lacks all reflected light, which further rays find.\n",
"vec3 sbl_radiance(sbl_Hit hit, vec3 place, bool last, out bool goes_on, out sbl_Material material) {\n",
"    int object = int(sbl_triangle_object(hit.triangle));\n",
"    sbl_Attributes at = SBL_PLAIN;\n",
"    if (!sbl_outgoing_is_plain(object, hit.back)) at = sbl_attributes_of(hit);\n",
"    vec3 radiance = sbl_outgoing(object, hit.back, at);\n",
"    goes_on = false;\n",
"#ifdef SBL_BOUNCED\n",
"    material = sbl_material(object, at);\n",
"    goes_on = !last && sbl_is_near(hit.distance);\n",
"    if (!goes_on) radiance += sbl_reflected(material, sbl_stored(hit.number, hit.back, place, hit.distance));\n",
"#endif\n",
"    return radiance;\n",
"}\n",
"\n",
"// Mean of 1 / cosine (to the normal) over the rays in u's stratum; each of the look's rays has its own stratum.\n",
"// The value of a single ray near the horizon is far too noisy.\n",
"float sbl_stratum_reciprocal(float u) {\n",
"    float n = float(rays), k = n - floor(u * n);\n",
"    return 2.0 * sqrt(n) / (sqrt(k) + sqrt(k - 1.0));\n",
"}\n",
"\n",
"#ifdef SBL_BOUNCED\n",
"// Maximum number of segments of a ray. The mean light of a cell may differ much from the light at a near hit. The\n",
"// store is not read there: a ray to a lamp finds the light of lamps, and the next segment finds the bounced light.\n",
"// Only the last segment reads the store at any distance.\n",
"const int SBL_LEGS = 3;\n",
"\n",
"// The rays that leave a near hit. All start at `from`.\n",
"struct sbl_Reflection {\n",
"    vec3 from;\n",
"    vec3 to_lamp;           // unit direction of the ray to a lamp\n",
"    float away;             // length of that ray; 0: no lamp gives light\n",
"    int number;             // number of the lamp's triangle in the scene, or -1\n",
"    vec3 light;             // light that the ray to the lamp finds if nothing is in its way\n",
"    vec3 direction, share;  // of the next segment: direction, and factor of the light that it finds\n",
"};\n",
"\n",
"// Chooses the rays that leave a near hit at random. direction: of the ray that arrives there\n",
"sbl_Reflection sbl_reflect(sbl_Hit hit, sbl_Material material, vec3 direction, uint hash) {\n",
"    vec3 p0 = sbl_triangle_corner_0(hit.triangle), e1 = sbl_triangle_corner_1(hit.triangle) - p0,\n",
"         e2 = sbl_triangle_corner_2(hit.triangle) - p0, e3 = e2 - e1;\n",
"    float longest = sqrt(max(dot(e1, e1), max(dot(e2, e2), dot(e3, e3))));\n",
"    vec3 across = cross(e1 / longest, e2 / longest) * (hit.back ? -1.0 : 1.0);\n",
"    uvec4 random = uvec4(hash, 0, 0, 0);\n",
"    for (int k = 1; k < 4; k++) random[k] = sbl_hash_step(random[k - 1], uint(k));\n",
"    sbl_Bounce bounce = sbl_bounce(material, across, -direction, sbl_unit_square(random.xy));\n",
"    n = bounce.off;\n",
"    above = SBL_OFFSET * (length(p0) + 2.0 * longest);\n",
"    position = p0 + hit.b1 * e1 + hit.b2 * e2;\n",
"    stand = position + above * n;\n",
"    sbl_Reflection r = sbl_Reflection(stand, n, 0.0, -1, vec3(0), bounce.direction, bounce.weight);\n",
"    if (lamp_leaves == 0) return r;\n",
"    sbl_Pick p = sbl_Pick(0, 1.0, sbl_unit_square(random.zw), false);\n",
"    sbl_descend(p, sbl_cluster(0).beyond < lamp_nodes ? -1 : 0, random.z);\n",
"    sbl_Lamp l = sbl_lamp(p.leaf);\n",
"    sbl_Sample s = sbl_sample(l, p.u);\n",
"    r.number = l.number;\n",
"    r.light = sbl_reflected(material, s.light) * (unit / p.share);\n",
"#ifdef SBL_TEXTURED\n",
"    if (l.kind == SBL_LAMP_TRIANGLE) {\n",
"        sbl_Attributes at = sbl_attributes_at(l.triangle, s.b.x, s.b.y);\n",
"        r.light *= sbl_emission_pattern(int(sbl_triangle_object(l.triangle)), at);\n",
"    }\n",
"#endif\n",
"    bool bounded = s.far < SBL_UNBOUNDED;\n",
"    vec3 to = bounded ? s.far * s.direction - above * n : s.direction;\n",
"    r.to_lamp = normalize(to);\n",
"    float away = bounded ? SBL_BEFORE_LAMP * length(to) : SBL_UNBOUNDED;\n",
"    r.away = max(r.light.r, max(r.light.g, r.light.b)) > 0.0 ? away : 0.0;\n",
"    return r;\n",
"}\n",
"#else\n",
"const int SBL_LEGS = 1;\n",
"#endif\n",
"\n",
"void main() {\n",
"    ivec2 texel = sbl_texel_of_invocation(), sheet = texel / blocks, within = texel % blocks;\n",
"    int sensor = sheet.y * columns + sheet.x - first_slot;\n",
"    if (sensor < 0 || sensor >= count) sbl_leave;\n",
"    vec3 origin = sbl_look_position(sensor);\n",
"    mat3 frame = sbl_frame(sbl_look_normal(sensor));\n",
"    uvec2 scramble = sbl_look_scramble(sensor);\n",
"    uint which = sbl_look_which(sensor);\n",
"    int number = int(which & SBL_LOOK_NUMBER), skip = number * rays, end = no_light && number > 0 ? 0 : rays;\n",
"\n",
"    vec4 sum = vec4(0), hits = vec4(0, 0, SBL_UNBOUNDED, 0);\n",
"    float squares = 0.0, other = 0.0;\n",
"    mat3x4 harmonics = mat3x4(0);  // stays 0 without SBL_DIRECTIONAL; so does the variable `even`\n",
"    vec4 even = vec4(0);\n",
"    int part = within.y * blocks.x + within.x, parts = blocks.x * blocks.y;\n",
"    // The variance is estimated from the differences between pairs of neighbours on the Morton curve.\n",
"    for (int k = 0, i = part << paired; i < end;\n",
"         k++, i = (part + (k >> paired) * parts << paired) + (k & paired)) {\n",
"        vec3 before = sum.rgb;\n",
"        uvec2 fraction = texelFetch(sbl_sequence, skip + i).xy ^ scramble;\n",
"        vec2 u = sbl_unit_square(fraction);\n",
"        float weight = 1.0;\n",
"#ifdef SBL_GUIDED\n",
"        weight = sbl_guide(int(which >> SBL_LOOK_GUIDE_SHIFT), u);\n",
"#endif\n",
"        vec3 direction = sbl_by_cosine(frame, u * vec2(spread, 1.0)), from = origin, share = vec3(weight);\n",
"        vec3 way = direction;\n",
"        float limit = SBL_UNBOUNDED;\n",
"#ifdef SBL_BOUNCED\n",
"        sbl_Reflection next;\n",
"#endif\n",
"        // Even turns trace the ray's segments; odd turns trace the rays from near hits to lamps.\n",
"        for (int turn = 0; turn < 2 * SBL_LEGS - 1; turn++) {\n",
"            sbl_Hit hit = sbl_trace(from, direction, limit);\n",
"#ifdef SBL_BOUNCED\n",
"            if ((turn & 1) == 1) {\n",
"                if (hit.triangle < 0 || hit.number == next.number) sum.rgb += share * next.light;\n",
"                share *= next.share;\n",
"                direction = next.direction;\n",
"                limit = SBL_UNBOUNDED;\n",
"                if (max(share.r, max(share.g, share.b)) <= 0.0) break;\n",
"                continue;\n",
"            }\n",
"#endif\n",
"            if (hit.triangle < 0) {\n",
"                sum.rgb += share * sbl_sky(direction);\n",
"                break;\n",
"            }\n",
"            bool goes_on;\n",
"            sbl_Material material;\n",
"            vec3 place = from + direction * hit.distance;\n",
"            sum.rgb += share * sbl_radiance(hit, place, turn == 2 * SBL_LEGS - 2, goes_on, material);\n",
"            if (turn == 0) {\n",
"                sum.a += hit.back ? weight : 0.0;\n",
"                hits.xy += weight * vec2(1.0, min(hit.distance, distance_limit));\n",
"                hits.z = min(hits.z, hit.distance);\n",
"            }\n",
"            if (!goes_on) break;\n",
"#ifdef SBL_BOUNCED\n",
"            uint hash = sbl_hash_step(sbl_hash_step(scramble.x, uint(skip + i)), scramble.y);\n",
"            next = sbl_reflect(hit, material, direction, sbl_hash_step(hash, uint(turn)));\n",
"            from = next.from;\n",
"            direction = next.to_lamp;\n",
"            limit = next.away;\n",
"#endif\n",
"        }\n",
"        vec4 counts = sbl_harmonics(way, frame[2], sbl_stratum_reciprocal(u.x));\n",
"        harmonics += outerProduct(counts, sum.rgb - before);\n",
"        even -= weight * counts;\n",
"        float light = dot(sum.rgb - before, SBL_LUMINANCE);\n",
"        if ((k & 1) == 1) squares += (light - other) * (light - other);\n",
"        other = light;\n",
"    }\n",
"    sbl_write(out_sum, sum / float(rays));\n",
"    sbl_write(out_hits, vec4(hits.xy / float(rays), hits.z, SBL_NEIGHBOURS * squares / float(rays * rays)));\n",
"    harmonics /= float(rays);\n",
"    sbl_write_harmonics(harmonics);\n",
"#ifdef SBL_DIRECTIONAL\n",
"    sbl_write(out_even, sbl_harmonics(frame[2], frame[2], 2.0) / float(parts) + even / float(rays));\n",
"#endif\n",
"}\n",
0 };
/* <<glsl */

static const sbl__recipe sbl__recipe_trace = {
    "trace", { sbl__glsl_fullscreen_vertex },
    { sbl__glsl_scene, sbl__glsl_frame, sbl__glsl_material, sbl__glsl_store, sbl__glsl_carrier, sbl__glsl_traverse,
      sbl__glsl_sky, sbl__glsl_guide, sbl__glsl_lamp, sbl__glsl_trace },
    { &sbl__object_record, &sbl__attributes_record, &sbl__node_record, &sbl__grid_node_record, &sbl__triangle_record,
      &sbl__look_record, &sbl__cut_record, &sbl__leaf_record, &sbl__lamp_node_record, &sbl__lamp_leaf_record,
      &sbl__light_record_record },
    SBL__TEXTURED | SBL__CUTOUTS | SBL__WIDE | SBL__COMPUTE | SBL__BOUNCED | SBL__GUIDED | SBL__DIRECTIONAL
};

/* Traces the rays of a batch, whose looks must be in b->table already. stuck: 1: each look traces one ray only, along
   its normal; paired: 1: an invocation traces pairs of rays, to measure the variance; 0: single rays, so that with one
   invocation per ray each output texel belongs to one ray */
static sbl_result sbl__trace_draw(sbl__device *d, const sbl__trace *t, const sbl__batch *b, int stuck, int paired) {
    const sbl_result result = sbl__use(d, &sbl__recipe_trace, sbl__features_of(b->scene, b->spec));
    if (result != SBL_SUCCESS) return result;
    sbl__rays_bind(d, b, &t->sequence, b->slots->blocks);
    if (b->spec->bounced) sbl__lights_bind(d, &b->scene->lights);
    sbl__set_int(d, "rays", stuck ? 1 : b->spec->rays);
    sbl__set_int(d, "paired", paired);
    sbl__set_int(d, "no_light", b->spec->no_light);
    sbl__set_int(d, "lamps_apart", !b->spec->paper);
    sbl__set_float(d, "epsilon", b->spec->epsilon);
    sbl__set_float(d, "spread", stuck ? 0.0f : 1.0f);
    sbl__set_float(d, "distance_limit", b->spec->distance_limit > 0 ? b->spec->distance_limit : SBL__UNBOUNDED);
    if (b->spec->guided) sbl__bind(d, "sbl_guides", &b->guides->texture);
    if (b->spec->without_sky) {
        const float black[3] = { 0, 0, 0 };
        sbl__set_vec3(d, "sky", black);
        sbl__set_float(d, "sky_limit", 0);
    }
    sbl__rays_send(d, b, &b->blocks->target, b->slots->blocks);
    return SBL_SUCCESS;
}

/* ======================================================================================================== >>job
   A job measures the light at a list of sites and writes one reading per site. The rooms that follow must not depend on
   whether the job traces rays or rasterises views. Pictures run jobs for pixels; other front ends run jobs for vertices
   or for points in the air. Every caller uses the same loop:

       sbl__job_begin(job, scene, task)                       the task names sites, readings and the sensors' settings
       while (sbl__job_step(device, job, slice) == SBL_UNFINISHED) ...
                                                              each step does one piece of bounded duration

   A job keeps its GPU resources until a task or a scene needs different ones. After an error the job can begin again.

   A job draws looks until all slots are full, reduces each look to one texel of results, and fills the slots again. The
   first round makes the sites' looks, the second round makes the stuck tests of sites that may be stuck:

       set up -> { draw -> aim rays at lamps -> reduce } ... -> read -> { draw -> reduce } ... -> read -> done
                 first round: looks                                     second round: stuck tests              */

#define SBL__READ_ROWS 16          /* maximum number of rows of results per readback */
#define SBL__LOOKS_FIRST 16        /* number of looks in the first submission, before their cost has been measured */
#define SBL__SUBMISSIONS 8         /* maximum number of submissions of views before the CPU waits for the GPU */
#define SBL__SUSPECT_SHARE 0.02f   /* a site gets a stuck test if after its first look back_share is larger */
#define SBL__STUCK_SHARE 0.75f     /* a sensor is stuck if its stuck test hits at less than this share of its offset */
#define SBL__RAY_LAYER_NOISE 1.0f  /* sbl__spec_layer_noise of a look of one ray */
#define SBL__TEXEL_NOISE 2.6f      /* views add the relative noise this / sbl__spec.size to that of a look; measured
                                      in a box with a lamp */

/* What a job has to do. The caller must keep the arrays until the job is done. */
typedef struct sbl__task {
    sbl__spec spec;
    const sbl__site *sites;
    sbl_reading *readings;      /* output: one reading per site */
    float *layers;              /* output of directional jobs: per site, 3 floats for each layer of light from layer 1
                                   on, see sbl__spec_layers */
    int site_count;
    int first_look;             /* number of the job's first look, which selects its slot. To repeat a look in the slot
                                   that it had in an earlier job, >>inspect sets the number that it had there */
    const sbl__guides *guides;  /* guides that direct the sites' rays, see >>guide */
} sbl__task;

typedef struct sbl__job_counts { int64_t views, texels, rays; int readbacks; } sbl__job_counts;

typedef enum sbl__job_stage {
    SBL__JOB_SETUP, SBL__JOB_WEIGH, SBL__JOB_COMPILE, SBL__JOB_DRAW, SBL__JOB_AIM, SBL__JOB_REDUCE, SBL__JOB_READ,
    SBL__JOB_DONE
} sbl__job_stage;

typedef struct sbl__job {
    sbl__stages stages;
    sbl__device *device;
    sbl__task task;
    const sbl__scene *scene;
    sbl__job_counts counts;     /* sums over all jobs since the caller last cleared them */
    sbl__spec made_for;         /* the spec for which the resources below were made */
    uint32_t made_for_scene;    /* version of the scene for which the resources were made; 0: they are missing,
                                   incomplete or outdated, and must be made */
    sbl__raster raster;
    sbl__trace trace;
    sbl__aim aim;
    sbl__blocks blocks;
    /* Results of the looks of a round. Look n has texel n % SBL__RESULTS_WIDTH, n / SBL__RESULTS_WIDTH.
       Texture 0: R * sbl__job_scale; sum of the weights of directions that see back faces
       Texture 1: sum of the weights of directions that see surfaces; sum of weight * distance; least distance (world
       units if traced, otherwise scene extents); variance of the luminance of texture 0, without SBL__TEXEL_NOISE
       Textures 2 to 4, if the job is directional: harmonics of red, green and blue light */
    sbl__blocks results;
    sbl__table table;           /* looks of a batch or of all slots, as shaders read them, see sbl__looks_send */
    sbl__look *looks;           /* the look in each slot */
    int lens;                   /* kind of the current round's looks: SBL__LENS_SITE or SBL__LENS_STUCK */
    int *suspects;              /* indices of the sites that need a stuck test */
    int suspect_count, suspect_room;
    int look_end;               /* 1 + number of the round's last look; the first is task.first_look, or 0 (stuck) */
    int site, look;             /* indices of the site (stuck tests: suspect) to draw or read next and of its look */
    int drawn, aimed, reduced;  /* number of the next look to draw, to trace rays to lamps for, and to reduce */
    int batch;                  /* number of looks in the batch that is partly drawn; 0: no batch is partly drawn */
    int triangle;               /* index of the next triangle to draw for this batch */
    struct { sbl__pace draw[SBL__LENSES], aim, reduce[SBL__LENSES]; } paces;
} sbl__job;

static void sbl__job_free(const sbl__device *d, sbl__job *j) {
    sbl__raster_free(d, &j->raster);
    sbl__table_delete(d, &j->trace.sequence);
    sbl__table_delete(d, &j->aim.sequence);
    sbl__blocks_free(d, &j->aim.light);
    sbl__blocks_free(d, &j->blocks);
    sbl__blocks_free(d, &j->results);
    sbl__table_delete(d, &j->table);
    sbl__free(d->base, j->looks);
    sbl__free(d->base, j->suspects);
    memset(j, 0, sizeof *j);
}

/* >>job: how sensors see */

/* Derives the spec of a job from the host's options, with defaults and the back end filled in. Except in the paper's
   mode, sbl__scene_step must have finished the scene. */
static void sbl__spec_make(sbl__spec *spec, const sbl__measurement *s, const sbl__scene *scene,
                           const sbl_context_desc *c) {
    const sbl__environment *e = &scene->environment;
    const int rays = s->options.rays ? s->options.rays : s->look_rays;
    const int no_light = s->options.mode != SBL_MODE_GI && !e->pixels && !s->every_ray &&
                     !(s->options.epsilon + e->sky[0] + e->sky[1] + e->sky[2] > 0);
    memset(spec, 0, sizeof *spec);
    spec->traced = s->options.backend == SBL_BACKEND_TRACE;
    spec->paper = s->options.mode == SBL_MODE_PAPER;
    spec->bounced = s->options.mode == SBL_MODE_GI;
    spec->looks = s->options.rays || spec->paper ? 1 : s->looks;
    spec->lamp_rays = !spec->paper && scene->lights.leaves ? rays : 0;
    spec->epsilon = s->options.epsilon;
    spec->seed = s->options.seed;
    spec->batch = c->batch > 0 ? c->batch : INT_MAX;
    if (spec->traced) {
        spec->no_light = no_light;
        spec->rays = no_light ? SBL__MIN(rays, SBL__TRACE_CHUNK) : rays;
    } else {
        spec->hemicube = s->sensor_kind == SBL_SENSOR_HEMICUBE;
        spec->size = s->options.sensor_size;
        spec->fov = s->sensor_fov;
        spec->view_texture_size = c->sensor_texture_size;
    }
}

/* Chooses the back end. The rule does not measure time, so that the same input always gives the same picture. */
static sbl_backend sbl__choose_backend(const sbl__measurement *s, const sbl__scene *scene) {
    const int views = s->options.mode == SBL_MODE_PAPER || s->sensor_kind == SBL_SENSOR_SINGLE || scene->draw;
    return s->options.backend != SBL_BACKEND_AUTO ? s->options.backend : views ? SBL_BACKEND_RASTER : SBL_BACKEND_TRACE;
}

/* Returns the distance of sensors from their surface, world units. reach: of the triangle (see surface.glsl);
   0: unknown */
static float sbl__spec_offset(const sbl__spec *spec, const sbl__scene *scene, float reach) {
    return SBL__OFFSET * (spec->traced && reach > 0 ? reach : scene->geometry.extent);
}

static int sbl__spec_layers(const sbl__spec *spec) { return spec->directional ? SBL__LAYERS : 1; }

/* Returns the part of the standard error of a look's layers 1 to 4 that does not come from the noise of R, divided by
   R: the few rays near the horizon have the largest weights in harmonics. */
static float sbl__spec_layer_noise(const sbl__spec *spec) {
    return spec->no_light || !spec->traced ? 0 : SBL__RAY_LAYER_NOISE / (float)sqrt((double)spec->rays);
}

/* Gets the size of a look's sheet: the texels of its views, or one row with a texel per ray. */
static void sbl__spec_sheet(const sbl__spec *spec, int *width, int *height) {
    sbl__layout layout;
    sbl__layout_make(&layout, spec->hemicube, SBL__MAX(spec->size, 1), spec->fov);
    *width = spec->traced ? spec->rays : layout.sheet[0];
    *height = spec->traced ? 1 : layout.sheet[1];
}

/* Returns the number of rays per look for a requested error. Where this is not enough, sensors take more looks. */
static int sbl__look_rays(float error) {
    return error >= 0.06f ? 16 : error >= 0.015f ? 32 : error >= 0.004f ? 64 : 128;
}

/* Returns the factor, a power of two, by which the rays of a look must grow for looks of this relative variance. Looks
   of too few rays miss rare light, so sensors underestimate their noise and refinement divides tiles because of it. */
static int sbl__look_growth(const sbl__measurement *s, float error, double variance) {
    int times = 1;
    if (s->options.rays || s->options.backend != SBL_BACKEND_TRACE) return 1;
    while (2 * times * s->look_rays <= SBL__LOOK_RAYS_MOST &&
           2 * times * SBL__LOOK_VARIANCE * (double)error * error <= variance) times *= 2;
    return times;
}

/* Fails to compile if sbl__spec has padding, which memcmp would compare. Add the size of each new field here. */
typedef char sbl__spec_has_no_padding[sizeof(sbl__spec) == 15 * sizeof(int) + 3 * sizeof(float) + sizeof(uint32_t)
                                      ? 1 : -1];

/* >>job: setting up */

static const sbl__slots *sbl__lens_slots(const sbl__job *j, int lens) {
    return j->task.spec.traced ? &j->trace.slots[lens] : &j->raster.lenses[lens].slots;
}

static const sbl__slots *sbl__job_slots(const sbl__job *j) { return sbl__lens_slots(j, j->lens); }

/* Returns the factor by which all radiance in the job's textures is multiplied. */
static float sbl__job_scale(const sbl__job *j) { return j->task.spec.traced ? 1 : j->raster.radiance_scale; }

/* Returns the layout of a look's views, or NULL if sensors trace rays. */
static const sbl__layout *sbl__job_layout(const sbl__job *j) {
    return j->task.spec.traced ? NULL : &j->raster.lenses[SBL__LENS_SITE].layout;
}

/* Makes the textures and the sequences of rays' directions, and allocates the array of looks, one per slot. */
static sbl_result sbl__job_setup(void *work, sbl__slice *slice) {
    sbl__job *j = (sbl__job *)work;
    const sbl__device *d = j->device;
    const sbl__spec *spec = &j->task.spec;
    int room = 0, lens;
    sbl_result result;
    (void)slice;
    j->device->gl.doing = "making the sensors' textures";
    j->lens = SBL__LENS_SITE;
    if (spec->traced) result = sbl__trace_setup(d, &j->trace, j->scene, spec, &j->blocks);
    else result = sbl__raster_setup(d, &j->raster, j->scene, spec, &j->blocks);
    if (result == SBL_SUCCESS) result = sbl__aim_setup(d, &j->aim, spec, sbl__job_slots(j), &j->scene->hierarchy);
    if (result != SBL_SUCCESS) return result;
    for (lens = 0; lens < SBL__LENSES; lens++) room = SBL__MAX(room, sbl__lens_slots(j, lens)->count);
    sbl__free(d->base, j->looks);
    j->looks = (sbl__look *)sbl__alloc_raw(d->base, (size_t)room, sizeof *j->looks);
    memset(&j->paces, 0, sizeof j->paces);
    return j->looks ? SBL_SUCCESS : SBL_ERROR_OUT_OF_MEMORY;
}

/* Computes the weights of views. Afterwards all resources exist. */
static sbl_result sbl__job_weigh(void *work, sbl__slice *slice) {
    sbl__job *j = (sbl__job *)work;
    for (; j->lens < SBL__LENSES && !j->task.spec.traced; j->lens++) {
        sbl__lens *lens = &j->raster.lenses[j->lens];
        const sbl_result result = sbl__raster_weigh(j->device, &j->raster, lens, &j->task.spec, slice);
        if (result != SBL_SUCCESS) return result;
    }
    j->made_for = j->task.spec;
    j->made_for_scene = j->scene->version;
    return SBL_SUCCESS;
}

/* >>glsl reduce_sum: shaders_embedded/reduce_sum.glsl, copied by scripts/embed_shaders */
static const char *const sbl__glsl_reduce_sum[] = {
"// Sums the partial sums of each look; an output texel is the result of one look. For views, reduce_blocks.glsl\n",
"// has made the partial sums; for rays, trace.glsl.\n",
"uniform sampler2D block_sums, block_hits;  // out_sum and out_hits of reduce_blocks.glsl or trace.glsl\n",
"uniform ivec2 blocks;          // width and height of a look's slot in the textures of partial sums, texels\n",
"uniform int columns, slots;    // number of slots per row; number of all slots\n",
"uniform int first, last;       // numbers of the first and last look to compute\n",
"uniform sampler2D lights;      // R by lamps.glsl: `parts` estimates per look, whose mean is added\n",
"uniform int parts;             // number of texels per look in `lights`, one below the other; 0: no lamps\n",
"layout(location = 0) out vec4 out_sum;   // texture 0 of sbl__job.results\n",
"layout(location = 1) out vec4 out_hits;  // texture 1 of sbl__job.results\n",
"uniform sampler2D block_red, block_green, block_blue, lights_red, lights_green, lights_blue;\n",
"uniform sampler2D block_even;  // out_even of trace.glsl, which corrects the harmonics\n",
"uniform bool even;             // true: add the correction by block_even\n",
"#ifdef SBL_DIRECTIONAL\n",
"layout(location = 2) out vec4 out_red;\n",
"layout(location = 3) out vec4 out_green;\n",
"layout(location = 4) out vec4 out_blue;\n",
"#endif\n",
"\n",
"// Sum of a look's harmonics of one colour, from partial sums and from lamps.\n",
"vec4 sbl_sum(sampler2D block_harmonics, ivec2 corner, sampler2D light_harmonics, ivec2 light_corner) {\n",
"    vec4 sum = vec4(0);\n",
"    for (int i = 0; i < blocks.x * blocks.y; i++)\n",
"        sum += texelFetch(block_harmonics, corner + ivec2(i % blocks.x, i / blocks.x), 0);\n",
"    for (int i = 0; i < parts; i++)\n",
"        sum += texelFetch(light_harmonics, light_corner + ivec2(0, i), 0) / float(parts);\n",
"    return sum;\n",
"}\n",
"\n",
"void main() {\n",
"    int sensor = int(gl_FragCoord.y) * SBL_RESULTS_WIDTH + int(gl_FragCoord.x);\n",
"    if (sensor < first || sensor > last) discard;\n",
"    ivec2 slot = ivec2(sensor % slots % columns, sensor % slots / columns);\n",
"    ivec2 corner = slot * blocks, light_corner = slot * ivec2(1, parts);\n",
"    vec4 sum = vec4(0), hits = vec4(0, 0, SBL_UNBOUNDED, 0), missed = vec4(0);\n",
"    for (int y = 0; y < blocks.y; y++) {\n",
"        vec4 row = vec4(0), row_hits = vec4(0);\n",
"        for (int x = 0; x < blocks.x; x++) {\n",
"            row += texelFetch(block_sums, corner + ivec2(x, y), 0);\n",
"            vec4 h = texelFetch(block_hits, corner + ivec2(x, y), 0);\n",
"            row_hits += h;\n",
"            hits.z = min(hits.z, h.z);\n",
"            if (even) missed += texelFetch(block_even, corner + ivec2(x, y), 0);\n",
"        }\n",
"        sum += row;\n",
"        hits.xyw += row_hits.xyw;\n",
"    }\n",
"    vec3 rays_light = sum.rgb;\n",
"    for (int i = 0; i < parts; i++) {\n",
"        vec4 light = texelFetch(lights, light_corner + ivec2(0, i), 0) / float(parts);\n",
"        sum.rgb += light.rgb;\n",
"        hits.w += light.a / float(parts);\n",
"    }\n",
"    out_sum = sum;\n",
"    out_hits = hits;\n",
"#ifdef SBL_DIRECTIONAL\n",
"    out_red = sbl_sum(block_red, corner, lights_red, light_corner) + rays_light.r * missed;\n",
"    out_green = sbl_sum(block_green, corner, lights_green, light_corner) + rays_light.g * missed;\n",
"    out_blue = sbl_sum(block_blue, corner, lights_blue, light_corner) + rays_light.b * missed;\n",
"#endif\n",
"}\n",
0 };
/* <<glsl */

static const sbl__recipe sbl__recipe_reduce_sum = {
    "reduce_sum", { sbl__glsl_fullscreen_vertex }, { sbl__glsl_reduce_sum }, { NULL }, SBL__DIRECTIONAL
};

/* >>job: a round */

/* Starts a round of looks of the kind `lens`: the sites' looks, or the suspects' stuck tests. */
static sbl_result sbl__job_start_round(sbl__job *j, int lens) {
    const sbl__device *d = j->device;
    const int most = d->gl.capabilities.max_texture_size, directional = j->task.spec.directional;
    const sbl__target *results = &j->results.target;
    double looks = 0;
    int i, rows;
    j->lens = lens;
    j->site = j->look = j->batch = 0;
    j->drawn = j->aimed = j->reduced = lens == SBL__LENS_SITE ? j->task.first_look : 0;
    if (lens == SBL__LENS_STUCK) looks = j->suspect_count;
    else for (i = 0; i < j->task.site_count; i++) looks += j->task.sites[i].looks;
    rows = (int)SBL__MIN((looks + j->drawn + SBL__RESULTS_WIDTH - 1) / SBL__RESULTS_WIDTH, INT_MAX);
    if (rows > most) {
        sbl__log(d->base, SBL_LOG_ERROR, SBL_LOG_ITEM_TOO_LARGE, "%.0f looks of sensors are too many for one job; the "
                 "driver's textures hold %.0f; use a smaller picture", looks, (double)most * SBL__RESULTS_WIDTH);
        return SBL_ERROR_UNSUPPORTED;
    }
    j->look_end = j->drawn + (int)looks;
    if (results->id && results->height >= rows && (results->count > 2) == directional) return SBL_SUCCESS;
    return sbl__blocks_make(d, &j->results, directional ? 5 : 2, SBL__RESULTS_WIDTH, rows);
}

/* Compiles one of the shader programs that the job needs. If all exist, starts the round of the sites' looks. */
static sbl_result sbl__job_compile(void *work, sbl__slice *slice) {
    sbl__job *j = (sbl__job *)work;
    sbl__device *d = j->device;
    const sbl__spec *spec = &j->task.spec;
    const unsigned features = sbl__aim_features(j->scene, spec);
    const struct { const sbl__recipe *recipe; int needed; } programs[] = {
        { &sbl__recipe_trace, spec->traced },
        { &sbl__recipe_sensor, !spec->traced },
        { &sbl__recipe_sky, !spec->traced && j->scene->environment.pixels && !spec->paper },
        { &sbl__recipe_lamps, spec->lamp_rays > 0 },
        { &sbl__recipe_reduce_blocks, !spec->traced },
        { &sbl__recipe_reduce_sum, 1 }
    };
    int i;
    (void)slice;
    for (i = 0; i < SBL__COUNT(programs); i++) {
        sbl_result result;
        if (!programs[i].needed || sbl__program_find(d, programs[i].recipe, features)) continue;
        result = sbl__program_need(d, programs[i].recipe, features);
        return result == SBL_SUCCESS ? SBL_UNFINISHED : result;
    }
    return sbl__job_start_round(j, SBL__LENS_SITE);
}

/* Makes the next look of the round. A stuck test has the position of the site's first look and faces the surface. */
static void sbl__job_next_look(sbl__job *j, sbl__look *out) {
    const int stuck = j->lens == SBL__LENS_STUCK;
    const sbl__site *site = &j->task.sites[stuck ? j->suspects[j->site] : j->site];
    int k;
    sbl__look_make(&j->task.spec, site, site->first + (stuck ? 0 : j->look), out);
    for (k = 0; stuck && k < 3; k++) out->normal[k] = -site->geometric_normal[k];
    if (!stuck && ++j->look < site->looks) return;
    j->look = 0;
    j->site++;
}

/* Describes the batch of `count` looks from look number `first` on. */
static void sbl__job_batch(const sbl__job *j, int first, int count, sbl__batch *out) {
    memset(out, 0, sizeof *out);
    out->scene = j->scene;
    out->spec = &j->task.spec;
    out->slots = sbl__job_slots(j);
    out->blocks = &j->blocks;
    out->first = first;
    out->slot = first % out->slots->count;
    out->looks = j->looks + out->slot;
    out->table = &j->table;
    out->guides = j->task.guides;
    out->count = count;
}

/* Draws `room` looks, or fewer if the slots or the round end before. If `room` is less than a batch, draws only a part
   of the scene's triangles to its views, and the next call continues. units: receives the work done, in looks */
static sbl_result sbl__job_submit(sbl__job *j, double room, double *units) {
    sbl__device *d = j->device;
    const sbl__spec *spec = &j->task.spec;
    const int all = j->scene->geometry.triangle_count, slots = sbl__job_slots(j)->count, slot = j->drawn % slots;
    const int *blocks = sbl__job_slots(j)->blocks, one_ray = j->lens == SBL__LENS_STUCK || spec->one_ray;
    sbl__batch b;
    int i, end = all;
    sbl_result result;
    if (spec->traced) room = sbl__whole_lots(d, room, blocks[0] * blocks[1]);
    if (!j->batch) {
        j->batch = (int)SBL__MIN(SBL__MAX(room, 1.0), (double)j->task.spec.batch);
        j->batch = SBL__MIN(j->batch, SBL__MIN(j->look_end - j->drawn, slots - slot));
        j->triangle = 0;
        for (i = 0; i < j->batch; i++) sbl__job_next_look(j, &j->looks[slot + i]);
    }
    sbl__job_batch(j, j->drawn, j->batch, &b);
    *units = j->batch;
    if (spec->traced) {
        result = sbl__looks_send(d, &j->table, b.looks, b.count, b.slots->count);
        if (result == SBL_SUCCESS) result = sbl__trace_draw(d, &j->trace, &b, one_ray, 1);
        *units = sbl__whole_lots(d, j->batch, blocks[0] * blocks[1]);
    } else {
        if (room < j->batch) end = (int)SBL__MIN(j->triangle + SBL__MAX(1.0, ceil(all * room / j->batch)), (double)all);
        if (all) *units *= (double)(end - j->triangle) / all;
        result = sbl__raster_draw(d, &j->raster, &j->raster.lenses[j->lens], &b, j->triangle, end);
    }
    if (result != SBL_SUCCESS) return result;
    j->triangle = end;
    if (end < all) return SBL_SUCCESS;
    j->drawn += j->batch;
    j->batch = 0;
    return SBL_SUCCESS;
}

/* Draws one submission of rays, or as many submissions of views as the slice has time for, without waiting in between:
   software renderers prepare one while they draw another, which saves a quarter of the time at 2,000 triangles. */
static sbl_result sbl__job_draw(void *work, sbl__slice *slice) {
    sbl__job *j = (sbl__job *)work;
    sbl__device *d = j->device;
    const int slots = sbl__job_slots(j)->count, first = j->drawn, left = j->look_end - first;
    const double fit = (slice->end - sbl__now()) / slice->longest;
    const int traced = j->task.spec.traced, most = traced ? 1 : (int)SBL__MIN(SBL__MAX(fit, 1), SBL__SUBMISSIONS);
    sbl__lens *lens = &j->raster.lenses[j->lens];
    double room, units = 0, all = 0;
    sbl_result result = SBL_SUCCESS;
    int i, full = 0;
    d->gl.doing = "drawing sensors";
    if (j->stages.at++ == 0 && !traced)  /* first draw the sky into all slots that looks will fill */
        sbl__raster_clear(d, &j->raster, lens, j->scene, SBL__MIN(slots, first % slots + left));
    room = sbl__pace_begin(&j->paces.draw[j->lens], slice, SBL__LOOKS_FIRST, 1e-6);
    for (i = 0; i < most && !full && result == SBL_SUCCESS; i++) {
        if (i) sbl__submit(d);
        result = sbl__job_submit(j, room, &units);
        all += units;
        full = j->drawn > first && (j->drawn == j->look_end || j->drawn % slots == 0);
    }
    if (result == SBL_SUCCESS) result = sbl__pace_end(d, &j->paces.draw[j->lens], all);
    return result == SBL_SUCCESS && !full ? SBL_UNFINISHED : result;
}

/* Returns 1 if the looks of the current round trace rays towards lamps. */
static int sbl__job_aims(const sbl__job *j) { return j->task.spec.lamp_rays && j->lens == SBL__LENS_SITE; }

/* Uses lamps.glsl for a batch. extra: SBL__INSPECT or 0; blocks: see sbl__rays_bind; scale: output / R */
static sbl_result sbl__aim_use(const sbl__job *j, const sbl__batch *b, unsigned extra, const int blocks[2],
                               float scale) {
    sbl__device *d = j->device;
    const unsigned features = sbl__aim_features(b->scene, b->spec);
    const sbl_result result = sbl__use(d, &sbl__recipe_lamps, features | extra);
    if (result != SBL_SUCCESS) return result;
    sbl__rays_bind(d, b, &j->aim.sequence, blocks);
    sbl__lights_bind(d, &b->scene->lights);
    sbl__set_int(d, "rays", b->spec->lamp_rays);
    sbl__set_float(d, "scale", scale);
    if (features & SBL__VIEWS) sbl__raster_bind(d, &j->raster, b->scene->geometry.extent);
    return SBL_SUCCESS;
}

/* Traces rays towards lamps for as many looks in the slots as the slice has time for. Their views are drawn already
   (see sbl__raster_bind). */
static sbl_result sbl__job_aim(void *work, sbl__slice *slice) {
    sbl__job *j = (sbl__job *)work;
    sbl__device *d = j->device;
    const double pace = sbl__pace_begin(&j->paces.aim, slice, SBL__LOOKS_FIRST, 1);
    const double room = SBL__MIN(sbl__whole_lots(d, pace, j->aim.parts), (double)j->task.spec.batch);
    const int count = (int)SBL__MIN(room, (double)(j->drawn - j->aimed)), blocks[2] = { 1, j->aim.parts };
    sbl__batch b;
    sbl_result result;
    d->gl.doing = "tracing rays towards lamps";
    sbl__job_batch(j, j->aimed, count, &b);
    result = sbl__looks_send(d, &j->table, b.looks, b.count, b.slots->count);
    if (result == SBL_SUCCESS) result = sbl__aim_use(j, &b, 0, blocks, sbl__job_scale(j));
    if (result != SBL_SUCCESS) return result;
    sbl__rays_send(d, &b, &j->aim.light.target, blocks);
    result = sbl__pace_end(d, &j->paces.aim, sbl__whole_lots(d, count, j->aim.parts));
    j->aimed += count;
    return result == SBL_SUCCESS && j->aimed < j->drawn ? SBL_UNFINISHED : result;
}

/* Computes the results of looks first .. last from their partial sums. */
static sbl_result sbl__job_sum(const sbl__job *j, int first, int last) {
    sbl__device *d = j->device;
    const sbl__slots *slots = sbl__job_slots(j);
    const sbl__target *out = &j->results.target;
    const sbl__texture *blocks = j->blocks.textures;
    const int count = j->blocks.target.count, aimed = sbl__job_aims(j);
    const int row = first / SBL__RESULTS_WIDTH, rows = last / SBL__RESULTS_WIDTH - row + 1;
    static const char *const block_names[6] = { "block_sums", "block_hits", "block_red", "block_green", "block_blue",
                                                "block_even" };
    static const char *const light_names[4] = { "lights", "lights_red", "lights_green", "lights_blue" };
    const sbl_result result =
        sbl__use(d, &sbl__recipe_reduce_sum, j->task.spec.directional ? (unsigned)SBL__DIRECTIONAL : 0);
    int k;
    if (result != SBL_SUCCESS) return result;
    sbl__pass_rows(d, out, row, rows);
    for (k = 0; k < 6; k++) sbl__bind(d, block_names[k], &blocks[k < count ? k : 0]);
    for (k = 0; k < 4; k++) sbl__bind(d, light_names[k], aimed ? &j->aim.light.textures[k] : &blocks[0]);
    sbl__set_int(d, "parts", aimed ? j->aim.parts : 0);
    sbl__set_int(d, "even", j->task.spec.traced);
    sbl__set_ints(d, "blocks", slots->blocks[0], slots->blocks[1]);
    sbl__set_int(d, "columns", slots->columns);
    sbl__set_int(d, "slots", slots->count);
    sbl__set_int(d, "first", first);
    sbl__set_int(d, "last", last);
    sbl__draw_screen(d);
    return SBL_SUCCESS;
}

/* Reduces the looks in some rows of slots to their results. */
static sbl_result sbl__job_reduce(void *work, sbl__slice *slice) {
    sbl__job *j = (sbl__job *)work;
    sbl__device *d = j->device;
    const sbl__slots *slots = sbl__job_slots(j);
    const int slot = j->reduced % slots->count, skip = slot % slots->columns, row = slot / slots->columns;
    const double room = sbl__pace_begin(&j->paces.reduce[j->lens], slice, SBL__LOOKS_FIRST, 1);
    const int most = (int)SBL__MIN(room / slots->columns + 1, (double)INT_MAX / slots->columns - 1) * slots->columns;
    const int count = SBL__MIN(j->drawn - j->reduced, most - skip), rows = (skip + count - 1) / slots->columns + 1;
    const int area[2] = { row, rows }, directional = !j->task.spec.traced && j->task.spec.directional;
    sbl_result result = SBL_SUCCESS;
    d->gl.doing = "adding up sensors";
    if (directional)
        result = sbl__looks_send(d, &j->table, j->looks, (j->drawn - 1) % slots->count + 1, slots->count);
    if (!j->task.spec.traced && result == SBL_SUCCESS)
        result = sbl__raster_reduce(d, &j->raster, &j->raster.lenses[j->lens], &j->blocks,
                                    directional ? &j->table : NULL, area);
    if (result == SBL_SUCCESS) result = sbl__job_sum(j, j->reduced, j->reduced + count - 1);
    if (result == SBL_SUCCESS) result = sbl__pace_end(d, &j->paces.reduce[j->lens], rows * slots->columns);
    j->reduced += count;
    return result == SBL_SUCCESS && j->reduced < j->drawn ? SBL_UNFINISHED : result;
}

/* >>job: reading */

/* Returns 1 if all numbers are finite. In scenes of extreme sizes they may not be (see sbl__scene_warn). */
static int sbl__reading_is_finite(const sbl_reading *r) {
    return sbl__all_finite(r->radiance, 3) && sbl__finite(&r->noise) && sbl__finite(&r->hit_share) &&
           sbl__finite(&r->back_share) && sbl__finite(&r->hit_mean) && sbl__finite(&r->hit_min);
}

/* Adds the result of a look to the sums in its site's reading; after the site's last look, divides them by the number
   of looks. found: as for sbl__job_judge */
static void sbl__job_take(sbl__job *j, const float *const found[5]) {
    const float *sum = found[0], *hits = found[1];
    const sbl__spec *spec = &j->task.spec;
    const float scale = sbl__job_scale(j);
    const float length = spec->traced ? 1 : j->scene->geometry.extent;
    const int looks = j->task.sites[j->site].looks, harmonics = 3 * (sbl__spec_layers(spec) - 1);
    sbl_reading *r = &j->task.readings[j->site];
    float *h = spec->directional ? j->task.layers + (size_t)harmonics * (size_t)j->site : NULL;
    float variance = 0;
    int k;
    if (j->look == 0) {
        memset(r, 0, sizeof *r);
        r->valid = 1;
        r->hit_share = hits[0];
        r->back_share = hits[0] > 0 ? sum[3] / hits[0] : 0;
        r->hit_mean = hits[0] > 0 ? hits[1] / hits[0] * length : 0;
        r->hit_min = hits[0] > 0 ? hits[2] * length : 0;
        for (k = 0; k < harmonics; k++) h[k] = 0;
    }
    for (k = 0; k < 3; k++) r->radiance[k] += sum[k] / scale;
    for (k = 0; k < harmonics; k++) h[k] += found[2 + k % 3][k / 3] / scale;
    if (spec->traced || spec->lamp_rays) variance = hits[3] / (scale * scale);
    if (!spec->traced && !spec->paper) {
        const float texels = SBL__TEXEL_NOISE / (float)spec->size * sbl__luminance(sum) / scale;
        variance += texels * texels;
    }
    r->noise += variance;
    if (++j->look < looks) return;
    for (k = 0; k < 3; k++) r->radiance[k] /= (float)looks;
    for (k = 0; k < harmonics; k++) h[k] /= (float)looks;
    r->noise = (float)sqrt((double)r->noise) / (float)looks;
    if (!sbl__reading_is_finite(r) || !sbl__all_finite(h, harmonics)) {
        memset(r, 0, sizeof *r);
        for (k = 0; k < harmonics; k++) h[k] = 0;
    }
    j->look = 0;
    j->site++;
}

/* Evaluates the result of the round's next look. found: the look's texel of each texture of results

   A sensor is stuck if the offset moved it through another surface into a body. A look's share of back faces cannot
   decide this: whole rooms are modelled inside out, and an emitter inside a body may hide the body's walls. A site
   whose first look sees more back faces than SBL__SUSPECT_SHARE therefore gets a stuck test, which looks from the
   sensor back to its surface. If it sees something nearer, the site's reading becomes invalid. */
static sbl_result sbl__job_judge(sbl__job *j, const float *const found[5]) {
    const float length = j->task.spec.traced ? 1 : j->scene->geometry.extent, *hits = found[1];
    const int stuck_test = j->lens == SBL__LENS_STUCK, site = stuck_test ? j->suspects[j->site++] : j->site;
    const int is_first = j->look == 0;
    const float offset = j->task.sites[site].offset;
    if (stuck_test) {
        if (hits[0] > 0 && hits[2] * length < SBL__STUCK_SHARE * offset) j->task.readings[site].valid = 0;
        return SBL_SUCCESS;
    }
    sbl__job_take(j, found);
    if (!is_first || offset <= 0 || !(j->task.readings[site].back_share > SBL__SUSPECT_SHARE)) return SBL_SUCCESS;
    if (!sbl__grow(j->device->base, &j->suspects, &j->suspect_room, j->suspect_count + 1, sizeof *j->suspects))
        return SBL_ERROR_OUT_OF_MEMORY;
    j->suspects[j->suspect_count++] = site;
    return SBL_SUCCESS;
}

/* Adds the finished round to the counts. Stuck tests are not counted. */
static void sbl__job_count(sbl__job *j) {
    const sbl__spec *spec = &j->task.spec;
    const int looks = j->look_end - j->task.first_look;
    const sbl__layout *l = &j->raster.lenses[SBL__LENS_SITE].layout;
    int i;
    if (j->lens == SBL__LENS_STUCK) return;
    for (i = 0; i < j->task.site_count && spec->traced; i++)
        j->counts.rays += (int64_t)spec->rays * (spec->no_light ? !j->task.sites[i].first : j->task.sites[i].looks);
    if (spec->traced) return;
    j->counts.views += (int64_t)looks * l->view_count;
    j->counts.texels += (int64_t)looks * l->sheet[0] * l->sheet[1];
}

/* Reads back up to SBL__READ_ROWS rows of results and evaluates their looks. If the sites' looks are done and there are
   suspects, starts the round of stuck tests. */
static sbl_result sbl__job_read(void *work, sbl__slice *slice) {
    sbl__job *j = (sbl__job *)work;
    const sbl__device *d = j->device;
    const sbl__target *from = &j->results.target;
    const int first = j->lens == SBL__LENS_SITE ? j->task.first_look : 0;
    const int end = (j->look_end + SBL__RESULTS_WIDTH - 1) / SBL__RESULTS_WIDTH;
    const int row = first / SBL__RESULTS_WIDTH + j->stages.at;
    const int rows = SBL__MIN(SBL__READ_ROWS, end - row), count = rows * SBL__RESULTS_WIDTH;
    const int parts = from->count;
    float *data = (float *)sbl__alloc_raw(d->base, (size_t)count, 16 * (size_t)parts);
    sbl_result result = data ? SBL_SUCCESS : SBL_ERROR_OUT_OF_MEMORY;
    int i, k;
    (void)slice;
    if (j->stages.at == 0) j->site = j->look = 0;
    j->device->gl.doing = "reading sensors";
    for (k = 0; k < parts && result == SBL_SUCCESS; k++)
        result = sbl__target_read(d, from, k, row, rows, data + 4 * (size_t)count * (size_t)k);
    j->counts.readbacks += parts;
    for (i = 0; i < count && result == SBL_SUCCESS; i++) {
        const int look = row * SBL__RESULTS_WIDTH + i;
        const float *found[5];
        for (k = 0; k < 5; k++) found[k] = data + 4 * ((size_t)count * (size_t)SBL__MIN(k, parts - 1) + (size_t)i);
        if (look >= first && look < j->look_end) result = sbl__job_judge(j, found);
    }
    sbl__free(d->base, data);
    j->stages.at += rows;
    if (result != SBL_SUCCESS || row + rows < end) return result == SBL_SUCCESS ? SBL_UNFINISHED : result;
    sbl__job_count(j);
    return j->lens == SBL__LENS_SITE && j->suspect_count ? sbl__job_start_round(j, SBL__LENS_STUCK) : SBL_SUCCESS;
}

/* Returns the stage that follows drawing, reducing or reading. */
static int sbl__job_next(void *work) {
    const sbl__job *j = (const sbl__job *)work;
    if (j->stages.stage == SBL__JOB_DRAW) return sbl__job_aims(j) ? SBL__JOB_AIM : SBL__JOB_REDUCE;
    if (j->drawn < j->look_end) return SBL__JOB_DRAW;
    return j->stages.stage == SBL__JOB_REDUCE ? SBL__JOB_READ : SBL__JOB_DONE;
}

/* >>job: beginning and stepping */

static void sbl__job_begin(sbl__job *j, const sbl__scene *scene, const sbl__task *task) {
    const int same = j->made_for_scene == scene->version &&
                     !memcmp(&j->made_for, &task->spec, offsetof(sbl__spec, seed));
    j->task = *task;
    j->scene = scene;
    j->suspect_count = 0;
    if (!same) j->made_for_scene = 0;
    j->stages.stage = task->site_count == 0 ? SBL__JOB_DONE : same ? SBL__JOB_COMPILE : SBL__JOB_SETUP;
    j->stages.at = 0;
}

/* Does one piece of bounded duration. Returns SBL_SUCCESS when all readings are written. */
static sbl_result sbl__job_step(sbl__device *d, sbl__job *j, sbl__slice *slice) {
    static const sbl__stage_row table[] = {
        { sbl__job_setup, NULL, NULL, NULL },
        { sbl__job_weigh, NULL, NULL, NULL },
        { sbl__job_compile, NULL, NULL, NULL },
        { sbl__job_draw, sbl__job_next, NULL, NULL },
        { sbl__job_aim, NULL, NULL, NULL },
        { sbl__job_reduce, sbl__job_next, NULL, NULL },
        { sbl__job_read, sbl__job_next, NULL, NULL }
    };
    sbl_result result;
    j->device = d;
    result = sbl__stages_step(&j->stages, table, SBL__COUNT(table), j, slice);
    if (result != SBL_SUCCESS && result != SBL_UNFINISHED) j->made_for_scene = 0;
    return result;
}

/* Returns the share of the job that is done, 0 to 1. The few stuck tests are not counted. */
static float sbl__job_progress(const sbl__job *j) {
    const int looks = j->look_end - j->task.first_look;
    if (j->stages.stage == SBL__JOB_DONE) return 1;
    if (j->stages.stage < SBL__JOB_DRAW) return 0;  /* the lens may still be that of the previous job */
    if (j->lens == SBL__LENS_STUCK) return 1;
    if (looks < 1) return 0;
    return (float)(j->drawn - j->task.first_look) / (float)looks;
}

/* >>job: the part of a context that all front ends (pictures, gathers and others) share */
typedef struct sbl__core {
    sbl__base base;
    sbl_context_desc desc;
    sbl__device device;
    sbl__scene scene;
    int has_scene;
    sbl__job job;
    struct sbl__bounce *bounce; /* the work that fills the store of bounced light; NULL: none */
    sbl_stats stats;            /* statistics of the work that was begun last */
} sbl__core;

/* Steps the job. When it is done, copies its counts to the statistics that the host reads. */
static sbl_result sbl__core_sense(sbl__core *c, sbl__slice *slice) {
    const sbl__job_counts *n = &c->job.counts;
    const sbl_result result = sbl__job_step(&c->device, &c->job, slice);
    if (result != SBL_SUCCESS) return result;
    c->stats.sensors.views = n->views;
    c->stats.sensors.texels = n->texels;
    c->stats.sensors.rays = n->rays;
    c->stats.sensors.readbacks += n->readbacks;
    c->job.counts.readbacks = 0;
    return SBL_SUCCESS;
}

/* Clears the statistics when work begins, except for the time spent on the scene. */
static void sbl__core_begin(sbl__core *c, const sbl__measurement *s) {
    const double scene_seconds = c->stats.seconds.scene;
    memset(&c->stats, 0, sizeof c->stats);
    memset(&c->job.counts, 0, sizeof c->job.counts);
    c->stats.scene.triangles = c->scene.geometry.triangle_count;
    c->stats.seconds.scene = scene_seconds;
    c->stats.mode = s->options.mode;
    c->stats.backend = s->options.backend;
}

/* ======================================================================================================== >>bounce
   Fills the store of bounced light. Rays from samples of all surfaces find the places that surfaces see, and these
   become points. Each leaf has up to SBL__BOUNCE_POINTS points, and each point sends SBL__BOUNCE_RAYS rays, whose hits
   become points of other leaves, until nothing new is hit. Finally surface samples fill the leaves that no ray hit.

   Ray r of leaf i hits leaf j, which reflects the share a of its light, so that R_i = L_i + mean over r of a * R_j,
   where L is direct light: from lamps (measured by the job) and from the environment (rays that hit nothing). The rays
   are kept, and the equations are solved by iteration (Kajiya 1986; gathering, as Cohen and Greenberg 1985).

   The differences between the points of a leaf tell its standard error. Light of that amount and of random sign is sent
   from leaf to leaf along the same rays; the amount that arrives is the uncertainty of light gathered there.

   Where a surface continues beneath an object that stands on it, one leaf must not get light on both sides of the
   object. From each leaf's first point contact rays go along its surface to the end of its cell, and planes that they
   hit cut the cell. Contact rays miss much in corners and narrow cells; therefore an object that a contact ray hits on
   a flat surface cuts all cells along its contact line. */

/* A fill is a number of leaves divided by the largest allowed number, sbl__store.max_leaves. */
#define SBL__FILL_AIM 0.35         /* fill for which the first size of cells is chosen */
#define SBL__FILL_FIRST 0.3        /* cells become larger if rays of surface samples alone hit more leaves than this */
#define SBL__FILL_FIRST_POWER 2.4  /* measured: growth of the cells' area by x^2.4 divides the number of leaves by x */
#define SBL__FILL_LEAST 0.12       /* cells become smaller if they fill less than this */
#define SBL__FILL_WIDER 0.6        /* from this fill on, new leaves belong to cells of level 1 */
#define SBL__FILL_WIDEST 0.8       /* from this fill on, new leaves belong to cells of level 2 */
#define SBL__BOUNCE_GROWTH 1.5     /* if leaves do not suffice, the cells' area is multiplied by at least this */
#define SBL__BOUNCE_GROWTH_MOST 2.0  /* if leaves do not suffice, the cells' area is multiplied by at most this */
#define SBL__BOUNCE_SHRINK_MOST 0.03  /* if leaves are left over, the cells' area is multiplied by at least this */
#define SBL__BOUNCE_POOL 16.0      /* limit of sbl__patching.pool. If leaves do not suffice even then, places
                                      without a leaf stay dark */
/* least number of positions of surface samples per area of a cell of level 0: 8 per area of the widest cells */
#define SBL__BOUNCE_SAMPLES_LEAST (8.0 / (1 << 2 * SBL__LEVEL_SHIFT * (SBL__LEVELS - 1)))
#define SBL__BOUNCE_SAMPLE_RAYS 4
#define SBL__BOUNCE_POINTS 4       /* largest number of points of a leaf */
#define SBL__BOUNCE_RAYS 16        /* rays of a point */
#define SBL__BOUNCE_SEQUENCES 4    /* sequences of ray directions, which the points of a leaf use in turn */
#define SBL__BOUNCE_LAMP_RAYS 8
#define SBL__BOUNCE_STUCK_RAYS 4   /* rays of a point's stuck test */
#define SBL__BOUNCE_CONTACTS 8     /* contact rays of a leaf: along its surface, to find objects that touch it */
#define SBL__CONTACT_STEEP 0.7     /* largest cosine between the normals of a surface and of a plane that cuts it */
#define SBL__CONTACT_APART 1e-3    /* least distance between two planes that cut a cell, in lengths of a cell */
#define SBL__CONTACT_LEAST 0.25    /* least length of a contact line, in lengths of a cell */
#define SBL__CONTACT_CACHE 1024    /* size of the hash table of contact lines that have cut their cells recently */
#define SBL__BOUNCE_BRIGHT 3.0     /* a warning is due when all light exceeds this multiple of the direct light */
#define SBL__BOUNCE_SCALED 4       /* number of first rounds after which all bounced light is multiplied by one
                                      factor per channel, so that it converges sooner */
#define SBL__BOUNCE_ROUNDS 200     /* largest number of rounds */
#define SBL__BOUNCE_TOLERANCE 2e-4 /* the rounds end when the estimated share of all light that is still missing is
                                      at most this */
#define SBL__UNCERTAINTY_ROUNDS 6
#define SBL__UNCERTAINTY_STRATA 0.35  /* measured: true error / error estimated from points; below 1, since rays have
                                      low discrepancy, and errors of neighbouring leaves compensate each other */
#define SBL__UNCERTAINTY_MOST 0.12 /* limit of the relative error estimated from points, which is too large where
                                      few rays all hit one leaf */
#define SBL__BOUNCE_TIME 0.35f     /* approximate share of the time of readings, vertices and probes that filling the
                                      store takes; >>map predicts it for pictures */
#define SBL__BOUNCE_CAST 0.6f      /* measured shares of the time of filling that rays between surfaces take, */
#define SBL__BOUNCE_LIT 0.93f      /* and these and the light of lamps together */
#define SBL__AIR_SITES 54          /* six sites at each of nine places */
#define SBL__AIR_RAYS 512
#define SBL__CAST_COLUMNS 256
#define SBL__CAST_ROWS 64
#define SBL__CAST_MOST (SBL__CAST_COLUMNS * SBL__CAST_ROWS)  /* most rays cast at once */

/* A ray, as cast.glsl reads it. limit: length; below 0: the ray leaves a surface with normal `direction` and
   cosine-weighted distribution. fractions: two random numbers of 16 bits each that choose such a ray's direction. */
#define SBL__CAST(X) \
    X(sbl__cast, VEC3, origin) X(sbl__cast, FLOAT, limit) \
    X(sbl__cast, VEC3, direction) X(sbl__cast, UINT, fractions)
SBL__RECORD(sbl__cast, SBL__CAST, "sbl_cast", "sbl_casts", SBL__BUFFER_TABLE("sbl_casts"), NULL)

#define SBL__NOWHERE 0xffffffffu
#define SBL__UNSEEN FLT_MAX        /* sbl__hit.distance of a surface sample whose rays hit nothing */

/* The hit of a ray, or a surface sample. distance: length of the ray, world units; for a surface sample, length of the
   shortest of its rays that hit a surface, or SBL__UNSEEN. place: triangle << 1 | back, or SBL__NOWHERE; after linking,
   the number of the leaf. albedo: share of light that the surface reflects, see sbl__share_pack. */
typedef struct sbl__hit { float position[3], distance; uint32_t place; uint16_t albedo[4]; } sbl__hit;

typedef struct sbl__hits { sbl__hit *list; int count, room; } sbl__hits;

typedef struct sbl__bounce_point { sbl__hit at; int leaf, number; /* index in its leaf */ } sbl__bounce_point;

/* A leaf while the store is filled. points: number of points; first: index of the first; valid: number of points with
   valid readings */
typedef struct sbl__bounce_leaf { int points, first, valid; } sbl__bounce_leaf;

enum {
    SBL__BOUNCE_PATCHES, SBL__BOUNCE_GRID, SBL__BOUNCE_SAMPLE, SBL__BOUNCE_CAST_SAMPLES, SBL__BOUNCE_PLACE,
    SBL__BOUNCE_CAST_CONTACTS, SBL__BOUNCE_CUT, SBL__BOUNCE_CAST_POINTS, SBL__BOUNCE_RELOCATE, SBL__BOUNCE_SORT,
    SBL__BOUNCE_LINK, SBL__BOUNCE_SITES, SBL__BOUNCE_LIGHT, SBL__BOUNCE_DIRECT, SBL__BOUNCE_GATHER, SBL__BOUNCE_NOISE,
    SBL__BOUNCE_PROPAGATE, SBL__BOUNCE_UNCERTAINTY, SBL__BOUNCE_SEND, SBL__BOUNCE_AIR, SBL__BOUNCE_DONE
};

typedef struct sbl__bounce {
    sbl__stages stages;
    sbl__core *core;
    sbl__store *store;
    const sbl__geometry *geometry;
    uint32_t scene, surfaces;        /* versions of the scene and of its surfaces for which the store is filled. After
                                        a change of only `scene`, only light is computed again */
    sbl__bounce_point *points;
    sbl__bounce_leaf *states;        /* one state per leaf */
    int point_count, point_room, state_room;
    sbl__hits hits;                  /* hits of the points' rays, SBL__BOUNCE_RAYS per point */
    sbl__patching patching;          /* this field and all below are freed and set to 0 when the store is ready */
    double samples_due;              /* number of positions due for surface samples on the triangles visited so far;
                                        each position gets two samples, one on each side */
    sbl__hits samples;               /* surface samples: places spread over all surfaces */
    sbl__hits queue;                 /* places that may become points. Its list points into that of samples, hits or
                                        released */
    sbl__hits waiting;               /* places from the queue, in leaves that contact rays have yet to cut */
    sbl__hits released;              /* places that waited for the last cuts; the queue points to them */
    sbl__hits contacts;              /* hits of contact rays, SBL__BOUNCE_CONTACTS per leaf, from leaf cut_leaves on */
    int cut_leaves;                  /* number of leaves, from 0 on, whose contact rays have been cast */
    int points_cast;                 /* number of points whose rays have been cast */
    uint32_t *sequence;              /* points of the unit square from which ray directions are made: two
                                        coordinates per point, in units of 2^-32, see sbl__sequence_make */
    /* A cache: place of the last ray from a surface, the normal there, and the distance from the surface at which its
       rays start (see sbl__place_normal) */
    struct { uint32_t place; float normal[3], offset; } origin;
    sbl__site *sites;                /* the job's sites: points; in the last job, places in the air */
    sbl_reading *readings;
    uint32_t recent_lines[SBL__CONTACT_CACHE];  /* hash table of contact lines (where an object touches a flat
                                                   surface) that have cut their cells; hash collisions drop some */
    int recheck;                     /* 1: a line has cut leaves below cut_leaves, where no place waits any more, so
                                        all of `hits` must be queued again */
    float *direct;                   /* 3 floats per leaf: direct light; after SBL__BOUNCE_NOISE, the leaf's noise */
    float *solved;                   /* light of each leaf, saved while the leaves hold noise */
    double change;                   /* balance.change of the previous round */
    /* sums over leaves in this round: direct light, all light before and after, absolute changes in all channels */
    struct { double direct[3], before[3], after[3], change; } balance;
    double needed_growth;            /* factor by which the cells' area must grow; 0: leaves suffice */
    double previous_fill;            /* fill when cells last became smaller; 0: they never did */
    int rounds;
    int samples_placed, seen_leaves; /* 1: surface samples have been placed; number of leaves that rays have hit */
    sbl__table casts;
    sbl__blocks blocks;
    sbl__pace pace;
    sbl__job job;
} sbl__bounce;

/* >>bounce: casting of rays on the GPU */

/* >>glsl cast: shaders_embedded/cast.glsl, copied by scripts/embed_shaders */
static const char *const sbl__glsl_cast[] = {
"// Finds the first hit of each ray. A ray with a negative limit leaves a surface, whose normal is `direction`, in a\n",
"// random direction with cosine distribution.\n",
"// out_place: xyz: position of the hit, far away if nothing was hit; w: 0 if nothing was hit, otherwise 1 + low\n",
"// bits of the triangle's number, negative for its back side\n",
"SBL_OUT(0, out_place);\n",
"// rgb: albedo for bounced light; a: high bits of the triangle's number\n",
"SBL_OUT(1, out_albedo);\n",
"\n",
"void main() {\n",
"    ivec2 texel = sbl_texel_of_invocation();\n",
"    int ray = texel.y * columns + texel.x;\n",
"    if (ray >= count) sbl_leave;\n",
"    vec3 origin = sbl_cast_origin(ray), direction = sbl_cast_direction(ray), albedo = vec3(0);\n",
"    float limit = sbl_cast_limit(ray);\n",
"    uint fractions = sbl_cast_fractions(ray);\n",
"    vec2 u = (vec2(fractions & 65535u, fractions >> 16) + 0.5) / 65536.0;\n",
"    if (limit < 0.0) direction = sbl_by_cosine(sbl_frame(direction), u);\n",
"    sbl_Hit hit = sbl_trace(origin, direction, abs(limit));\n",
"    float low = 0.0, high = 0.0;\n",
"    if (hit.triangle >= 0) {\n",
"        int object = int(sbl_triangle_object(hit.triangle));\n",
"        albedo = sbl_bounced(sbl_material(object, sbl_attributes_of(hit)));\n",
"        low = (float(hit.number % SBL_CAST_NUMBERS) + 1.0) * (hit.back ? -1.0 : 1.0);\n",
"        high = float(hit.number / SBL_CAST_NUMBERS);\n",
"    }\n",
"    sbl_write(out_place, vec4(origin + direction * hit.distance, low));\n",
"    sbl_write(out_albedo, vec4(albedo, high));\n",
"}\n",
0 };
/* <<glsl */

static const sbl__recipe sbl__recipe_cast = {
    "cast", { sbl__glsl_fullscreen_vertex },
    { sbl__glsl_scene, sbl__glsl_frame, sbl__glsl_material, sbl__glsl_carrier, sbl__glsl_traverse, sbl__glsl_cast },
    { &sbl__object_record, &sbl__attributes_record, &sbl__node_record, &sbl__grid_node_record, &sbl__triangle_record,
      &sbl__cast_record },
    SBL__TEXTURED | SBL__CUTOUTS | SBL__WIDE | SBL__COMPUTE
};

static sbl_result sbl__cast_send(sbl__bounce *b, const sbl__cast *rays, int count) {
    const sbl__scene *scene = &b->core->scene;
    sbl__device *d = &b->core->device;
    sbl_result result = sbl__blocks_make(d, &b->blocks, 2, SBL__CAST_COLUMNS, SBL__CAST_ROWS);
    if (result == SBL_SUCCESS)
        result = sbl__buffer_stream(d, &b->casts.buffer, SBL__CAST_MOST * sizeof *rays, rays,
                                    (size_t)count * sizeof *rays);
    if (result == SBL_SUCCESS) result = sbl__table_attach(d, &b->casts, SBL__GL_RGBA32UI, 0);
    if (result == SBL_SUCCESS) result = sbl__use(d, &sbl__recipe_cast, scene->features);
    if (result != SBL_SUCCESS) return result;
    sbl__scene_bind(d, scene);
    sbl__hierarchy_bind(d, &scene->hierarchy);
    sbl__bind_table(d, "sbl_casts", &b->casts);
    sbl__set_ints(d, "blocks", 1, 1);
    sbl__set_int(d, "columns", SBL__CAST_COLUMNS);
    sbl__set_int(d, "first_slot", 0);
    sbl__set_int(d, "count", count);
    sbl__invoke(d, &b->blocks.target, 0, (count + SBL__CAST_COLUMNS - 1) / SBL__CAST_COLUMNS, count);
    return sbl__gl_check(&d->gl);
}

/* Decodes the output of cast.glsl. */
static void sbl__cast_take(const sbl__cast *ray, const float place[4], const float albedo[4], sbl__hit *out) {
    const double low = fabs((double)place[3]) - 1, number = low + SBL__CAST_NUMBERS * (double)albedo[3];
    double length2 = 0;
    int k;
    memset(out, 0, sizeof *out);
    memcpy(out->position, place, sizeof out->position);
    for (k = 0; k < 3; k++) length2 += ((double)place[k] - ray->origin[k]) * ((double)place[k] - ray->origin[k]);
    out->distance = (float)sqrt(length2);
    out->place = low < 0 ? SBL__NOWHERE : (uint32_t)number << 1 | (place[3] < 0);
    sbl__share_pack(albedo, out->albedo);
}

/* Casts the rays stages.at to count - 1, piece by piece. make: computes a ray from its number. hits: receives the hit
   of each ray at the ray's number */
static sbl_result sbl__bounce_cast(sbl__bounce *b, void (*make)(sbl__bounce *b, int number, sbl__cast *out), int count,
                                   sbl__hits *hits, const sbl__slice *slice) {
    sbl__device *d = &b->core->device;
    const double room = sbl__pace_begin(&b->pace, slice, 1024, 64);
    const int at = b->stages.at, some = (int)SBL__MIN(SBL__MIN(room, (double)SBL__CAST_MOST), count - at);
    const int rows = (some + SBL__CAST_COLUMNS - 1) / SBL__CAST_COLUMNS;
    const size_t texels = (size_t)rows * SBL__CAST_COLUMNS;
    sbl__cast *rays;
    float *places, *albedos;
    sbl_result result;
    int i;
    d->gl.doing = "casting rays between surfaces";
    if (!sbl__grow(d->base, &hits->list, &hits->room, count, sizeof *hits->list)) return SBL_ERROR_OUT_OF_MEMORY;
    if (some <= 0) return SBL_SUCCESS;
    rays = (sbl__cast *)sbl__alloc_raw(d->base, texels, sizeof *rays + 32);
    if (!rays) return SBL_ERROR_OUT_OF_MEMORY;
    places = (float *)(rays + texels);
    albedos = places + 4 * texels;
    for (i = 0; i < some; i++) make(b, at + i, &rays[i]);
    result = sbl__cast_send(b, rays, some);
    if (result == SBL_SUCCESS) result = sbl__target_read(d, &b->blocks.target, 0, 0, rows, places);
    if (result == SBL_SUCCESS) result = sbl__target_read(d, &b->blocks.target, 1, 0, rows, albedos);
    for (i = 0; i < some && result == SBL_SUCCESS; i++)
        sbl__cast_take(&rays[i], places + 4 * (size_t)i, albedos + 4 * (size_t)i, &hits->list[at + i]);
    sbl__free(d->base, rays);
    if (result == SBL_SUCCESS) result = sbl__pace_end(d, &b->pace, some);
    if (result != SBL_SUCCESS) return result;
    b->core->stats.sensors.readbacks += 2;
    b->core->stats.store.rays += some;
    b->stages.at += some;
    return b->stages.at < count ? SBL_UNFINISHED : SBL_SUCCESS;
}

/* >>bounce: places that may become points */

/* Returns the patch word of a place: the triangle's word, with SBL__PATCH_BACK inverted on the back side and
   SBL__PATCH_NEAR set if a short ray hit the place. */
static uint32_t sbl__place_patch(const sbl__store *s, const sbl__hit *at) {
    const uint32_t patch = s->patches[at->place >> 1] ^ (at->place & 1 ? SBL__PATCH_BACK : 0);
    return patch | (at->distance * SBL__NEAR_PART < s->length ? SBL__PATCH_NEAR : 0);
}

/* Returns the reference to the leaf of a place, which is 0 if there is no leaf yet; NULL: no slot is left. If the cell
   has no leaf and leaves are becoming scarce, a wider cell is used. patch: NULL, or receives the patch word with the
   level of the cell. Places at distance SBL__UNSEEN, which only points in the air may see, use the widest cells. */
static uint32_t *sbl__place_find(const sbl__store *s, const sbl__hit *at, uint32_t *patch) {
    static const double fills[SBL__LEVELS] = { SBL__FILL_WIDER, SBL__FILL_WIDEST, 1 };
    uint32_t *reference = NULL, word = sbl__place_patch(s, at);
    int level = at->distance < SBL__UNSEEN ? 0 : SBL__LEVELS - 1, depth;
    word += SBL__PATCH_LEVEL * (uint32_t)level;
    for (; level < SBL__LEVELS; level++, word += SBL__PATCH_LEVEL) {
        reference = sbl__store_find(s, word, at->position, &depth);
        if (reference && (*reference || s->leaf_count < fills[level] * s->max_leaves)) break;
    }
    if (patch) *patch = word;
    return reference;
}

/* Computes the normal on the side of a place. Returns the distance from the surface at which its rays start. */
static float sbl__place_normal(const sbl__geometry *g, uint32_t place, float normal[3]) {
    const float *p[3];
    double n[3], longest = 0, away = 0;
    int i, k;
    sbl__scene_triangle(g, place >> 1, p);
    sbl__scene_normal(g, place >> 1, n);
    for (i = 0; i < 3; i++) {
        double side = 0;
        for (k = 0; k < 3; k++) side += ((double)p[i][k] - p[(i + 1) % 3][k]) * ((double)p[i][k] - p[(i + 1) % 3][k]);
        longest = SBL__MAX(longest, side);
    }
    for (k = 0; k < 3; k++) {
        normal[k] = (float)(place & 1 ? -n[k] : n[k]);
        away += (double)p[0][k] * p[0][k];
    }
    return (float)(SBL__OFFSET * (sqrt(away) + 2 * sqrt(longest)));
}

static sbl_result sbl__bounce_patches(void *work, sbl__slice *slice) {
    sbl__bounce *b = (sbl__bounce *)work;
    sbl__base *base = &b->core->base;
    uint32_t **words = &b->store->patches;
    sbl_result result;
    if (b->sequence) return sbl__patching_step(&b->patching, slice);
    sbl__free(base, *words);
    *words = (uint32_t *)sbl__alloc(base, (size_t)b->geometry->triangle_count, sizeof **words);
    b->sequence = sbl__sequence_make(base, SBL__BOUNCE_SEQUENCES, SBL__BOUNCE_RAYS, 1);
    b->origin.place = SBL__NOWHERE;
    if (!*words || !b->sequence) return SBL_ERROR_OUT_OF_MEMORY;
    result = sbl__patching_begin(base, &b->patching, b->geometry);
    return result == SBL_SUCCESS ? SBL_UNFINISHED : result;
}

/* Empties the store. Sets the length of cells, and the area below which patches are joined, so that leaves on both
   sides of all surfaces use about the share SBL__FILL_AIM of the store. In a scene without area, cells have length
   1. */
static sbl_result sbl__bounce_grid(void *work, sbl__slice *slice) {
    sbl__bounce *b = (sbl__bounce *)work;
    sbl__base *base = &b->core->base;
    sbl__patching *p = &b->patching;
    sbl__store *s = b->store;
    const double area = 2 * p->area / (SBL__FILL_AIM * s->max_leaves);
    int k, room = 1024;
    (void)slice;
    p->least = SBL__PATCH_LEAST * p->pool * area;
    s->length = (float)sqrt(p->growth * area);
    if (!sbl__between(&s->length, FLT_MIN, FLT_MAX)) s->length = 1;
    for (k = 0; k < 3; k++) s->origin[k] = b->geometry->bounds[0][k] - s->length * (1.37f + 0.21f * (float)k);
    while (room < 2 * s->max_leaves) room *= 2;
    sbl__free(base, s->cells);
    s->cells = (sbl__cell_slot *)sbl__alloc(base, (size_t)room, sizeof *s->cells);
    s->cell_room = s->cells ? room : 0;
    s->leaf_count = s->cut_count = 0;
    return s->cells ? SBL_SUCCESS : SBL_ERROR_OUT_OF_MEMORY;
}

static int sbl__bounce_triangles(void *work) { return ((sbl__bounce *)work)->geometry->triangle_count; }

/* Returns 0 if out of memory. */
static int sbl__hits_add(sbl__bounce *b, sbl__hits *to, const sbl__hit *hit) {
    if (!sbl__grow(&b->core->base, &to->list, &to->room, to->count + 1, sizeof *to->list)) return 0;
    to->list[to->count++] = *hit;
    return 1;
}

/* Sets a triangle's patch word, and adds surface samples at random positions, one on each side. Per area of a cell
   there are patching.growth positions, or SAMPLES_LEAST if more. samples_due carries fractions to the next triangle. */
static sbl_result sbl__bounce_sample(void *work, int at) {
    sbl__bounce *b = (sbl__bounce *)work;
    const uint32_t triangle = (uint32_t)at;
    const double density = SBL__MAX(b->patching.growth, SBL__BOUNCE_SAMPLES_LEAST), length = (double)b->store->length;
    const float *p[3];
    double normal[3], number = floor(b->samples_due);
    sbl__hit sample;
    int k;
    memset(&sample, 0, sizeof sample);
    b->store->patches[triangle] = sbl__patch_word(&b->patching, triangle);
    if (sbl__triangle_object(b->geometry, triangle)->flags & SBL_MATERIAL_HIDDEN_FROM_SENSORS) return SBL_SUCCESS;
    b->samples_due += density * sbl__scene_normal(b->geometry, triangle, normal) / (length * length);
    sbl__scene_triangle(b->geometry, triangle, p);
    for (; number < floor(b->samples_due); number++) {
        const uint32_t hash = sbl__hash((uint32_t)number);
        double u = hash / 4294967296.0, v = sbl__hash(hash) / 4294967296.0;
        if (u + v > 1) { u = 1 - u; v = 1 - v; }
        for (k = 0; k < 3; k++)
            sample.position[k] = (float)(p[0][k] + u * ((double)p[1][k] - p[0][k]) + v * ((double)p[2][k] - p[0][k]));
        for (k = 0; k < 2; k++) {
            sample.place = triangle << 1 | (uint32_t)k;
            if (!sbl__hits_add(b, &b->samples, &sample)) return SBL_ERROR_OUT_OF_MEMORY;
        }
    }
    return SBL_SUCCESS;
}

/* Adds a point at a place, moved into its triangle's plane because hits are rounded. Returns 0 if out of memory. */
static int sbl__bounce_add_point(sbl__bounce *b, const sbl__hit *at, int leaf) {
    sbl__bounce_point *point;
    const float *corner = sbl__triangle_corner(b->geometry, at->place >> 1, 0);
    double normal[3], off = 0;
    int k;
    if (!sbl__grow(&b->core->base, &b->points, &b->point_room, b->point_count + 1, sizeof *b->points)) return 0;
    point = &b->points[b->point_count++];
    point->at = *at;
    point->leaf = leaf;
    point->number = b->states[leaf].points++;
    sbl__scene_normal(b->geometry, at->place >> 1, normal);
    for (k = 0; k < 3; k++) off += normal[k] * ((double)at->position[k] - corner[k]);
    for (k = 0; k < 3; k++) point->at.position[k] = (float)(at->position[k] - off * normal[k]);
    return 1;
}

/* Adds a leaf without points and lets the reference lead to it. Returns 0 if out of memory. */
static int sbl__bounce_add_leaf(sbl__bounce *b, uint32_t *reference) {
    sbl__base *base = &b->core->base;
    sbl__store *s = b->store;
    const int leaf = s->leaf_count;
    if (!sbl__grow(base, &s->leaves, &s->leaf_room, leaf + 1, sizeof *s->leaves) ||
        !sbl__grow(base, &b->states, &b->state_room, leaf + 1, sizeof *b->states)) return 0;
    memset(&s->leaves[leaf], 0, sizeof *s->leaves);
    memset(&b->states[leaf], 0, sizeof *b->states);
    b->states[leaf].first = b->point_count;
    *reference = (uint32_t)++s->leaf_count;
    return 1;
}

/* Returns the number of queued places, or 0 once there is no room for more leaves. */
static int sbl__bounce_queued(void *work) {
    const sbl__bounce *b = (const sbl__bounce *)work;
    return b->needed_growth > 0 ? 0 : b->queue.count;
}

/* Makes a point of a queued place if its leaf needs one. Sets b->needed_growth if there is no room for a new leaf. */
static sbl_result sbl__bounce_place(void *work, int number) {
    sbl__bounce *b = (sbl__bounce *)work;
    const sbl__hit *at = &b->queue.list[number];
    const sbl__store *s = b->store;
    uint32_t *reference;
    int leaf, added, ok = 1;
    if (at->place == SBL__NOWHERE) return SBL_SUCCESS;
    reference = sbl__place_find(s, at, NULL);
    if (!reference || (!*reference && s->leaf_count >= s->max_leaves)) {
        if (b->patching.pool < SBL__BOUNCE_POOL)
            b->needed_growth = SBL__MIN(1.3 * b->queue.count / (number + 1), SBL__BOUNCE_GROWTH_MOST);
        return SBL_SUCCESS;
    }
    added = *reference == 0;
    if (added && !sbl__bounce_add_leaf(b, reference)) return SBL_ERROR_OUT_OF_MEMORY;
    leaf = (int)*reference - 1;
    if (!added && leaf >= b->cut_leaves) ok = sbl__hits_add(b, &b->waiting, at);
    else if (b->states[leaf].points < SBL__BOUNCE_POINTS) ok = sbl__bounce_add_point(b, at, leaf);
    return ok ? SBL_SUCCESS : SBL_ERROR_OUT_OF_MEMORY;
}

/* Queues places that may become points. Returns the stage that makes points of them. */
static int sbl__bounce_queue(sbl__bounce *b, sbl__hit *list, int count) {
    b->queue.list = list;
    b->queue.count = count;
    return SBL__BOUNCE_PLACE;
}

/* Starts again with an area of cells multiplied by `growth`. Larger cells do not help where patches outnumber leaves,
   so the area below which patches are pooled grows, too. */
static int sbl__bounce_restart(sbl__bounce *b, double growth) {
    sbl__patching *p = &b->patching;
    p->growth *= growth;
    if (growth > 1 || p->pool <= 1) p->pool *= growth;
    b->samples_due = b->needed_growth = 0;
    b->samples.count = b->waiting.count = b->point_count = b->cut_leaves = b->points_cast = 0;
    b->recheck = b->samples_placed = 0;
    memset(b->recent_lines, 0, sizeof b->recent_lines);
    return SBL__BOUNCE_GRID;
}

/* Returns the next stage: rays from new leaves and points until none are new; finally points at surface samples. */
static int sbl__bounce_after_place(void *work) {
    sbl__bounce *b = (sbl__bounce *)work;
    const double fill = (double)b->store->leaf_count / b->store->max_leaves;
    if (b->needed_growth > 0) return sbl__bounce_restart(b, SBL__MAX(b->needed_growth, SBL__BOUNCE_GROWTH));
    if (!b->cut_leaves && fill > SBL__FILL_FIRST && b->patching.pool < SBL__BOUNCE_POOL)
        /* Too many: the rays of these leaves would hit still more. */
        return sbl__bounce_restart(b, pow(fill / SBL__FILL_FIRST, SBL__FILL_FIRST_POWER));
    if (b->store->leaf_count > b->cut_leaves) return SBL__BOUNCE_CAST_CONTACTS;
    if (b->points_cast < b->point_count) return SBL__BOUNCE_CAST_POINTS;
    if (b->recheck) {  /* A cut through a leaf with points can leave one side without any. */
        b->recheck = 0;
        return sbl__bounce_queue(b, b->hits.list, b->point_count * SBL__BOUNCE_RAYS);
    }
    if (b->samples_placed && b->seen_leaves > 0 && fill < SBL__FILL_LEAST && fill > 2 * b->previous_fill) {
        b->previous_fill = fill;  /* Rays hit few surfaces, so cells can be smaller. */
        return sbl__bounce_restart(b, SBL__MAX(fill / SBL__FILL_AIM, SBL__BOUNCE_SHRINK_MOST));
    }
    if (b->samples_placed) return SBL__BOUNCE_RELOCATE;
    b->samples_placed = 1;
    b->seen_leaves = b->store->leaf_count;
    return sbl__bounce_queue(b, b->samples.list, b->samples.count);
}

/* >>bounce: contact rays and contact lines */

static void sbl__bounce_contact_ray(sbl__bounce *b, int number, sbl__cast *out) {
    const sbl__store *s = b->store;
    const int leaf = b->cut_leaves + number / SBL__BOUNCE_CONTACTS;
    const sbl__hit *at = &b->points[b->states[leaf].first].at;
    const double turn = number % SBL__BOUNCE_CONTACTS + sbl__hash((uint32_t)leaf) / 4294967296.0;
    const float offset = sbl__place_normal(b->geometry, at->place, out->direction);
    double right[3], up[3];
    uint32_t cube[3], patch;
    float length;
    int k;
    sbl__place_find(s, at, &patch);
    length = sbl__cell_length(s, patch);
    sbl__frame(out->direction, 2 * SBL__PI / SBL__BOUNCE_CONTACTS * turn, right, up);
    sbl__cell_place(s, patch, at->position, cube);
    out->limit = FLT_MAX;
    for (k = 0; k < 3; k++) {
        const float x = at->position[k] - s->origin[k] - length * (float)cube[k], d = (float)right[k];
        out->origin[k] = at->position[k] + offset * out->direction[k];
        if (cube[k] && d > 1e-6f) out->limit = SBL__MIN(out->limit, (length - x) / d);
        if (cube[k] && d < -1e-6f) out->limit = SBL__MIN(out->limit, -x / d);
    }
    for (k = 0; k < 3; k++) out->direction[k] = right[k] > 0 || right[k] < 0 ? (float)right[k] : 0;
    out->fractions = 0;
    out->limit = SBL__MIN(SBL__MAX(out->limit, 0.0f), 2 * length);
}

static sbl_result sbl__bounce_cast_contacts(void *work, sbl__slice *slice) {
    sbl__bounce *b = (sbl__bounce *)work;
    return sbl__bounce_cast(b, sbl__bounce_contact_ray, (b->store->leaf_count - b->cut_leaves) * SBL__BOUNCE_CONTACTS,
                            &b->contacts, slice);
}

/* The line along which an object stands on a flat surface. */
typedef struct sbl__contact {
    uint32_t patch;              /* patch word of the flat surface on which the object stands */
    uint32_t object;             /* identifies the object: its patch word | 1 if flat, or 2 * triangle */
    float normal[3], distance;   /* plane of the touching object: dot(normal, x) = distance */
    double from[3], along[3];    /* one end of the line, and the vector to the other end */
} sbl__contact;

static void sbl__contact_position(const sbl__contact *line, double t, float position[3]) {
    int k;
    for (k = 0; k < 3; k++) position[k] = (float)(line->from[k] + t * line->along[k]);
}

/* Makes the line where the surface of `at` meets the plane that its contact ray hit, within the bounds of both: of flat
   patches or, if the object is not flat, of its triangle. Returns 0 if the line is short or the surface not flat. */
static int sbl__contact_make(const sbl__bounce *b, const sbl__hit *at, const sbl__hit *hit, sbl__contact *line) {
    const sbl__store *s = b->store;
    const sbl__geometry *g = b->geometry;
    const sbl__patch *patches = b->patching.patches;
    const uint32_t patch = sbl__place_patch(s, at) & ~SBL__PATCH_NEAR, other = s->patches[hit->place >> 1];
    const double length = (double)s->length;
    const int flat = (other & SBL__PATCH_FLAT) != 0;
    const sbl__box *own;
    sbl__box others;
    float normal[3];
    double along[3], t0 = -1e300, t1 = 1e300, slack;
    int k;
    if (!(patch & SBL__PATCH_FLAT)) return 0;
    own = &patches[patch >> SBL__PATCH_SHIFT].bounds;
    if (flat) others = patches[other >> SBL__PATCH_SHIFT].bounds;
    else sbl__box_of_triangle(&others, g, hit->place >> 1);
    slack = SBL__CONTACT_APART * length + 4 * (double)sbl__place_normal(g, at->place, normal);
    sbl__place_normal(g, hit->place, line->normal);
    for (k = 0; k < 3; k++) {
        const int m = (k + 1) % 3, n = (k + 2) % 3;
        along[k] = (double)normal[m] * line->normal[n] - (double)normal[n] * line->normal[m];
    }
    if (!sbl__normalize(along)) return 0;
    for (k = 0; k < 3; k++) {
        const float low = SBL__MAX(own->low[k], others.low[k]), high = SBL__MIN(own->high[k], others.high[k]);
        const double from = (double)low - slack - hit->position[k], to = (double)high + slack - hit->position[k];
        if (fabs(along[k]) < 1e-6) continue;
        t0 = SBL__MAX(t0, SBL__MIN(from / along[k], to / along[k]));
        t1 = SBL__MIN(t1, SBL__MAX(from / along[k], to / along[k]));
    }
    if (!(t1 - t0 >= SBL__CONTACT_LEAST * length)) return 0;
    for (k = 0; k < 3; k++) {
        line->from[k] = hit->position[k] + t0 * along[k];
        line->along[k] = (t1 - t0) * along[k];
    }
    line->distance = sbl__dot(line->normal, sbl__triangle_corner(g, hit->place >> 1, 0));
    line->object = flat ? other | 1u : hit->place & ~1u;
    line->patch = patch;
    return 1;
}

/* Cuts the leaf to which the reference leads or, if it leads to a cut, the leaves below it that the line crosses.
   depth: number of cuts above the reference. range: where the line enters and leaves the part of the cell to which the
   reference leads, 0 to 1 along the line */
static sbl_result sbl__contact_part(sbl__bounce *b, const sbl__contact *line, uint32_t *reference,
                                    const double range[2], int depth) {
    sbl__store *s = b->store;
    const double apart = SBL__CONTACT_APART * (double)s->length;
    sbl_result result = SBL_SUCCESS;
    double over[2];
    int i, side, cut;
    if (*reference < SBL__CELL_CUT) {
        const float *first = *reference ? b->points[b->states[*reference - 1].first].at.position : NULL;
        if (depth >= SBL__CELL_DEPTH) return SBL_SUCCESS;
        if (first && (int)*reference <= b->cut_leaves) b->recheck = 1;
        return sbl__store_cut(&b->core->base, s, reference, line->normal, line->distance,
                              first && sbl__dot(line->normal, first) > line->distance);
    }
    cut = (int)(*reference & ~SBL__CELL_CUT);
    for (i = 0; i < 2; i++) {
        float position[3];
        sbl__contact_position(line, range[i], position);
        over[i] = (double)sbl__dot(s->cuts[cut].normal, position) - s->cuts[cut].distance;
    }
    /* A cut along the same line exists already. */
    if (SBL__MAX(fabs(over[0]), fabs(over[1])) <= apart) return SBL_SUCCESS;
    for (side = 0; side < 2 && result == SBL_SUCCESS; side++) {
        const double sign = side ? 1 : -1, cross = range[0] + over[0] / (over[0] - over[1]) * (range[1] - range[0]);
        double part[2];
        if (SBL__MAX(sign * over[0], sign * over[1]) <= apart) continue;
        for (i = 0; i < 2; i++) part[i] = sign * over[i] < 0 ? cross : range[i];
        result = sbl__contact_part(b, line, &s->cuts[cut].sides[side], part, depth + 1);
    }
    return result;
}

/* Cuts all cells that the line crosses and that have the patch word line->patch. */
static sbl_result sbl__contact_walk(sbl__bounce *b, const sbl__contact *line) {
    const sbl__store *s = b->store;
    const double length = (double)sbl__cell_length(s, line->patch);
    double next[3], step[3], range[2] = { 0, 0 };
    sbl_result result = SBL_SUCCESS;
    int k;
    for (k = 0; k < 3; k++) {  /* next: where along the line, 0 to 1, the line leaves the current cube on each axis */
        const double x = (line->from[k] - s->origin[k]) / length, d = line->along[k] / length;
        const int still = fabs(d) < 1e-9 || (int)(line->patch >> SBL__PATCH_AXIS_SHIFT & 3u) == k;
        next[k] = still ? 2 : (d > 0 ? floor(x) + 1 - x : floor(x) - x) / d;
        step[k] = still ? 0 : 1 / fabs(d);
    }
    while (range[0] < 1 && result == SBL_SUCCESS) {
        const int axis = next[0] <= next[1] && next[0] <= next[2] ? 0 : next[1] <= next[2] ? 1 : 2;
        uint32_t *reference;
        float middle[3];
        range[1] = SBL__MIN(next[axis], 1.0);
        sbl__contact_position(line, 0.5 * (range[0] + range[1]), middle);
        reference = sbl__store_slot(s, line->patch, middle);
        if (reference) result = sbl__contact_part(b, line, reference, range, 0);
        range[0] = range[1];
        next[axis] += step[axis];
    }
    return result;
}

/* Cuts all cells along the line, those of each level and of near and far rays, unless b->recent_lines has the line. */
static sbl_result sbl__contact_cut(sbl__bounce *b, sbl__contact *line) {
    const uint32_t patch = line->patch, hash = sbl__hash_step(sbl__hash_step(0, patch), line->object);
    uint32_t *recent = &b->recent_lines[hash % SBL__CONTACT_CACHE];
    sbl_result result = SBL_SUCCESS;
    int i;
    if (*recent == hash) return SBL_SUCCESS;
    *recent = hash;
    for (i = 0; i < 2 * SBL__LEVELS && result == SBL_SUCCESS; i++) {
        line->patch = patch | (i & 1 ? SBL__PATCH_NEAR : 0) | SBL__PATCH_LEVEL * (uint32_t)(i >> 1);
        result = sbl__contact_walk(b, line);
    }
    return result;
}

/* Cuts a leaf by a plane that one of its contact rays hit, if the plane is steep to the surface and the hit still lies
   in the same leaf. On a flat surface, cuts all cells along the contact line instead. */
static sbl_result sbl__bounce_cut(sbl__bounce *b, int leaf, const sbl__hit *hit) {
    sbl__store *s = b->store;
    const sbl__hit *at = &b->points[b->states[leaf].first].at;
    float beyond[3], normal[3], own[3], apart, distance;
    sbl__contact line;
    uint32_t *reference, patch;
    int k, depth;
    sbl__place_find(s, at, &patch);
    sbl__place_normal(b->geometry, at->place, own);
    sbl__place_normal(b->geometry, hit->place, normal);
    distance = sbl__dot(normal, hit->position);
    apart = sbl__dot(normal, at->position) - distance;
    if (fabs((double)sbl__dot(normal, own)) > SBL__CONTACT_STEEP) return SBL_SUCCESS;
    if (sbl__contact_make(b, at, hit, &line)) return sbl__contact_cut(b, &line);
    if (fabs((double)apart) < SBL__CONTACT_APART * (double)s->length) return SBL_SUCCESS;
    for (k = 0; k < 3; k++)  /* a position a little beyond the hit, as seen along the ray */
        beyond[k] = hit->position[k] + (float)SBL__CONTACT_APART * (hit->position[k] - at->position[k]);
    reference = sbl__store_find(s, patch, beyond, &depth);
    if (!reference || *reference != (uint32_t)leaf + 1 || depth >= SBL__CELL_DEPTH) return SBL_SUCCESS;
    reference = sbl__store_find(s, patch, at->position, &depth);
    return sbl__store_cut(&b->core->base, s, reference, normal, distance, sbl__dot(normal, at->position) > distance);
}

static int sbl__bounce_uncut_leaves(void *work) {
    const sbl__bounce *b = (const sbl__bounce *)work;
    return b->store->leaf_count - b->cut_leaves;
}

static sbl_result sbl__bounce_cuts(void *work, int at) {
    sbl__bounce *b = (sbl__bounce *)work;
    const sbl__hit *hits = &b->contacts.list[at * SBL__BOUNCE_CONTACTS];
    sbl_result result = SBL_SUCCESS;
    int i;
    for (i = 0; i < SBL__BOUNCE_CONTACTS && result == SBL_SUCCESS; i++)
        if (hits[i].place != SBL__NOWHERE) result = sbl__bounce_cut(b, b->cut_leaves + at, &hits[i]);
    return result;
}

static void sbl__swap(void *a, void *b, size_t bytes) {
    char keep[SBL__BOUNCE_RAYS * sizeof(sbl__hit)];
    memcpy(keep, a, bytes);
    memcpy(a, b, bytes);
    memcpy(b, keep, bytes);
}

static int sbl__bounce_after_cuts(void *work) {
    sbl__bounce *b = (sbl__bounce *)work;
    b->cut_leaves = b->store->leaf_count;
    sbl__swap(&b->waiting, &b->released, sizeof b->waiting);
    b->waiting.count = 0;
    return sbl__bounce_queue(b, b->released.list, b->released.count);
}

/* >>bounce: rays */

/* Makes a cosine-weighted ray from a place. number: number of the point of b->sequence that chooses the
   direction, after a hash of `seed` has scrambled it */
static void sbl__bounce_surface_ray(sbl__bounce *b, const sbl__hit *at, uint32_t seed, int number, sbl__cast *out) {
    const float *normal = b->origin.normal;
    int k;
    if (b->origin.place != at->place) {
        b->origin.place = at->place;
        b->origin.offset = sbl__place_normal(b->geometry, at->place, b->origin.normal);
    }
    out->fractions = (b->sequence[2 * number] ^ sbl__hash(seed)) >> 16 |
                     ((b->sequence[2 * number + 1] ^ sbl__hash(seed + 1u)) & 0xffff0000u);
    for (k = 0; k < 3; k++) {
        out->direction[k] = normal[k];
        out->origin[k] = at->position[k] + b->origin.offset * normal[k];
    }
    out->limit = -SBL__UNBOUNDED;
}

static void sbl__bounce_sample_ray(sbl__bounce *b, int number, sbl__cast *out) {
    const int sample = number / SBL__BOUNCE_SAMPLE_RAYS;
    sbl__bounce_surface_ray(b, &b->samples.list[sample], sbl__hash((uint32_t)sample), number % SBL__BOUNCE_SAMPLE_RAYS,
                            out);
}

/* Casts rays from surface samples and queues their hits. The distance of a sample becomes that of its nearest hit. */
static sbl_result sbl__bounce_cast_samples(void *work, sbl__slice *slice) {
    sbl__bounce *b = (sbl__bounce *)work;
    const int rays = b->samples.count * SBL__BOUNCE_SAMPLE_RAYS;
    const sbl_result result = sbl__bounce_cast(b, sbl__bounce_sample_ray, rays, &b->hits, slice);
    int i;
    if (result != SBL_SUCCESS) return result;
    for (i = 0; i < rays; i++) {
        sbl__hit *sample = &b->samples.list[i / SBL__BOUNCE_SAMPLE_RAYS];
        if (i % SBL__BOUNCE_SAMPLE_RAYS == 0) sample->distance = SBL__UNSEEN;
        if (b->hits.list[i].place == SBL__NOWHERE) continue;
        sample->distance = SBL__MIN(sample->distance, b->hits.list[i].distance);
    }
    sbl__bounce_queue(b, b->hits.list, rays);
    return SBL_SUCCESS;
}

static void sbl__bounce_point_ray(sbl__bounce *b, int number, sbl__cast *out) {
    const sbl__bounce_point *p = &b->points[number / SBL__BOUNCE_RAYS];
    const int index = p->number % SBL__BOUNCE_SEQUENCES * SBL__BOUNCE_RAYS + number % SBL__BOUNCE_RAYS;
    const uint32_t hash = sbl__hash((uint32_t)p->leaf + 0x10000000u * (uint32_t)(p->number / SBL__BOUNCE_SEQUENCES));
    sbl__bounce_surface_ray(b, &p->at, hash, index, out);
}

static sbl_result sbl__bounce_cast_points(void *work, sbl__slice *slice) {
    sbl__bounce *b = (sbl__bounce *)work;
    b->stages.at = SBL__MAX(b->stages.at, b->points_cast * SBL__BOUNCE_RAYS);
    return sbl__bounce_cast(b, sbl__bounce_point_ray, b->point_count * SBL__BOUNCE_RAYS, &b->hits, slice);
}

static int sbl__bounce_after_rays(void *work) {
    sbl__bounce *b = (sbl__bounce *)work;
    const int first = b->points_cast * SBL__BOUNCE_RAYS;
    b->points_cast = b->point_count;
    return sbl__bounce_queue(b, b->hits.list + first, b->point_count * SBL__BOUNCE_RAYS - first);
}

/* >>bounce: points in order */

static int sbl__bounce_points(void *work) { return ((sbl__bounce *)work)->point_count; }
static int sbl__bounce_leaves(void *work) { return ((sbl__bounce *)work)->store->leaf_count; }

/* Finds each point's leaf again, because later cuts may have put the point into another leaf. */
static sbl_result sbl__bounce_relocate(void *work, int at) {
    sbl__bounce *b = (sbl__bounce *)work;
    sbl__bounce_point *p = &b->points[at];
    uint32_t *reference = sbl__place_find(b->store, &p->at, NULL);
    if (reference && !*reference && !sbl__bounce_add_leaf(b, reference)) return SBL_ERROR_OUT_OF_MEMORY;
    if (reference) p->leaf = (int)*reference - 1;
    return SBL_SUCCESS;
}

/* Numbers the points of each leaf, and sets `first` of each leaf to its value after sorting. */
static int sbl__bounce_after_relocate(void *work) {
    sbl__bounce *b = (sbl__bounce *)work;
    const int leaves = b->store->leaf_count;
    int i, next = 0;
    for (i = 0; i < leaves; i++) b->states[i].points = 0;
    for (i = 0; i < b->point_count; i++) b->points[i].number = b->states[b->points[i].leaf].points++;
    for (i = 0; i < leaves; next += b->states[i++].points) b->states[i].first = next;
    return SBL__BOUNCE_SORT;
}

/* Sorts points and their hits by leaf. Rounds of bounces in another order take 3 to 6 times as long. */
static sbl_result sbl__bounce_sort(void *work, int at) {
    sbl__bounce *b = (sbl__bounce *)work;
    sbl__bounce_point *p = &b->points[at];
    sbl__hit *hits = b->hits.list;
    int to;
    while ((to = b->states[p->leaf].first + p->number) != at) {
        sbl__swap(p, &b->points[to], sizeof *p);
        sbl__swap(&hits[(size_t)at * SBL__BOUNCE_RAYS], &hits[(size_t)to * SBL__BOUNCE_RAYS],
                  SBL__BOUNCE_RAYS * sizeof *hits);
    }
    return SBL_SUCCESS;
}

/* Replaces the places that a point's rays hit with numbers of leaves. */
static sbl_result sbl__bounce_link(void *work, int at) {
    sbl__bounce *b = (sbl__bounce *)work;
    sbl__hit *hit = &b->hits.list[(size_t)at * SBL__BOUNCE_RAYS], *const end = hit + SBL__BOUNCE_RAYS;
    for (; hit < end; hit++) {
        const uint32_t *reference = hit->place == SBL__NOWHERE ? NULL : sbl__place_find(b->store, hit, NULL);
        hit->place = reference && *reference ? *reference - 1 : SBL__NOWHERE;
    }
    return SBL_SUCCESS;
}

/* >>bounce: light from lamps */

static sbl_result sbl__bounce_allocate(void *work, sbl__slice *slice) {
    sbl__bounce *b = (sbl__bounce *)work;
    sbl__base *base = &b->core->base;
    const size_t sites = (size_t)SBL__MAX(b->point_count, SBL__AIR_SITES), leaves = (size_t)b->store->leaf_count;
    (void)slice;
    if (b->solved) return SBL_SUCCESS;  /* A change of lights has interrupted an earlier solution. */
    b->sites = (sbl__site *)sbl__alloc_raw(base, sites, sizeof *b->sites);
    b->readings = (sbl_reading *)sbl__alloc_raw(base, sites, sizeof *b->readings);
    b->direct = (float *)sbl__alloc_raw(base, leaves, 3 * sizeof *b->direct);
    b->solved = (float *)sbl__alloc_raw(base, leaves, 3 * sizeof *b->solved);
    return b->sites && b->readings && b->direct && b->solved ? SBL_SUCCESS : SBL_ERROR_OUT_OF_MEMORY;
}

static sbl_result sbl__bounce_site(void *work, int at) {
    sbl__bounce *b = (sbl__bounce *)work;
    const sbl__hit *hit = &b->points[at].at;
    sbl__site *site = &b->sites[at];
    memset(site, 0, sizeof *site);
    memcpy(site->position, hit->position, sizeof site->position);
    site->offset = sbl__place_normal(b->geometry, hit->place, site->normal);
    memcpy(site->geometric_normal, site->normal, sizeof site->normal);
    site->number = (uint32_t)at;
    site->looks = 1;
    return SBL_SUCCESS;
}

/* Begins a job that measures light from lamps (SBL_MODE_DIRECT) or all light at the first `count` sites. */
static void sbl__bounce_measure(sbl__bounce *b, sbl_mode mode, int count) {
    const int direct = mode == SBL_MODE_DIRECT;
    sbl__core *c = b->core;
    sbl__measurement measurement;
    sbl__task task;
    memset(&measurement, 0, sizeof measurement);
    memset(&task, 0, sizeof task);
    measurement.options.mode = mode;
    measurement.options.backend = SBL_BACKEND_TRACE;
    measurement.options.rays = direct ? SBL__BOUNCE_LAMP_RAYS : SBL__AIR_RAYS;
    sbl__spec_make(&task.spec, &measurement, &c->scene, &c->desc);
    if (direct) {
        task.spec.rays = SBL__BOUNCE_STUCK_RAYS;
        task.spec.without_sky = 1;  /* sbl__bounce_sky computes the light of the environment. */
    }
    task.sites = b->sites;
    task.readings = b->readings;
    task.site_count = count;
    memset(&b->job.counts, 0, sizeof b->job.counts);
    sbl__job_begin(&b->job, &c->scene, &task);
}

static int sbl__bounce_after_sites(void *work) {
    sbl__bounce *b = (sbl__bounce *)work;
    sbl__bounce_measure(b, SBL_MODE_DIRECT, b->point_count);
    return SBL__BOUNCE_LIGHT;
}

static sbl_result sbl__bounce_run_job(void *work, sbl__slice *slice) {
    sbl__bounce *b = (sbl__bounce *)work;
    sbl_stats *stats = &b->core->stats;
    const sbl_result result = sbl__job_step(&b->core->device, &b->job, slice);
    if (result == SBL_SUCCESS) {
        stats->sensors.readbacks += b->job.counts.readbacks;
        stats->store.rays += b->job.counts.rays;
    }
    return result;
}

/* >>bounce: all bounces at once */

/* Computes the light of the environment from those rays of a point that hit nothing. */
static void sbl__bounce_sky(const sbl__bounce *b, int point, float out[3]) {
    const sbl__hit *hits = &b->hits.list[(size_t)point * SBL__BOUNCE_RAYS];
    int i, k;
    out[0] = out[1] = out[2] = 0;
    for (i = 0; i < SBL__BOUNCE_RAYS; i++) {
        double direction[3];
        float light[3];
        if (!(hits[i].distance > SBL__FAR)) continue;
        for (k = 0; k < 3; k++) direction[k] = (double)hits[i].position[k] - b->points[point].at.position[k];
        if (!sbl__normalize(direction)) continue;
        sbl__environment_radiance(&b->core->scene.environment, direction, light);
        for (k = 0; k < 3; k++) out[k] += light[k] / SBL__BOUNCE_RAYS;
    }
}

/* Averages the direct light of a leaf's points. */
static sbl_result sbl__bounce_direct(void *work, int at) {
    sbl__bounce *b = (sbl__bounce *)work;
    sbl__bounce_leaf *state = &b->states[at];
    sbl__leaf *leaf = &b->store->leaves[at];
    float *light = b->direct + 3 * at, sky[3], all_sky[3] = { 0, 0, 0 };
    int i, k;
    light[0] = light[1] = light[2] = 0;
    for (i = state->first, state->valid = 0; i < state->first + state->points; i++)
        state->valid += b->readings[i].valid;
    for (i = state->first; i < state->first + state->points; i++) {
        if (!b->readings[i].valid) continue;
        sbl__bounce_sky(b, i, sky);
        for (k = 0; k < 3; k++) all_sky[k] += sky[k] / (float)state->valid;
        for (k = 0; k < 3; k++) light[k] += b->readings[i].radiance[k] / (float)state->valid;
    }
    leaf->lamps = sbl__rgbe(light);
    for (k = 0; k < 3; k++) leaf->light[k] = light[k] += all_sky[k];
    return SBL_SUCCESS;
}

#define SBL__BOUNCE_UNIT (SBL__SHARE_ONE * SBL__BOUNCE_RAYS)

/* Adds SBL__BOUNCE_UNIT times the light that a point receives from leaves. */
static void sbl__bounce_add_received(const sbl__bounce *b, int point, float sum[3]) {
    const sbl__hit *hits = &b->hits.list[(size_t)point * SBL__BOUNCE_RAYS];
    int j;
    for (j = 0; j < SBL__BOUNCE_RAYS; j++)
        if (hits[j].place != SBL__NOWHERE)
            sbl__add_reflected(hits[j].albedo, b->store->leaves[hits[j].place].light, sum);
}

/* Sets a leaf's light to its direct light plus the mean light that its points receive. Leaves earlier in the round
   already have their new light (Gauss-Seidel iteration). */
static sbl_result sbl__bounce_gather(void *work, int at) {
    sbl__bounce *b = (sbl__bounce *)work;
    const sbl__bounce_leaf *leaf = &b->states[at];
    float *light = b->store->leaves[at].light, sum[3] = { 0, 0, 0 };
    int i, k;
    if (at == 0) memset(&b->balance, 0, sizeof b->balance);
    for (i = leaf->first; i < leaf->first + leaf->points; i++)
        if (b->readings[i].valid) sbl__bounce_add_received(b, i, sum);
    for (k = 0; k < 3; k++) {
        const float direct = b->direct[3 * at + k];
        const float next = direct + (leaf->valid ? sum[k] / (SBL__BOUNCE_UNIT * (float)leaf->valid) : 0);
        b->balance.direct[k] += (double)direct;
        b->balance.before[k] += (double)light[k];
        b->balance.after[k] += (double)next;
        b->balance.change += fabs((double)next - light[k]);
        light[k] = next;
    }
    return SBL_SUCCESS;
}

/* Warns once per scene if clamping of albedos makes a visible difference. direct, all: sums of direct and all light */
static void sbl__bounce_warn(const sbl__bounce *b, double direct, double all) {
    const sbl__geometry *g = b->geometry;
    int i, white = 0;
    for (i = 0; i < g->mesh_count; i++) white += sbl__holds_light(&g->objects[i]);
    if (!white || !(all > SBL__BOUNCE_BRIGHT * direct) || b->store->warned) return;
    sbl__log(&b->core->base, SBL_LOG_WARNING, SBL_LOG_ITEM_ALBEDO, "%d meshes have albedos above %g in a scene with "
             "much bounced light; bounced light uses %g instead, because closed rooms with such walls would never grow "
             "dark", white, (double)SBL__BOUNCE_ALBEDO, (double)SBL__BOUNCE_ALBEDO);
    b->store->warned = 1;
}

/* In the first rounds, scales gathered light so that emitted and lost light balance, channel by channel. This settles
   the overall brightness of a room, the slowest part of convergence, at once. */
static int sbl__bounce_after_gather(void *work) {
    sbl__bounce *b = (sbl__bounce *)work;
    const sbl__store *s = b->store;
    double all_direct = 0, sum = 0, ratio;
    int i, k;
    for (k = 0; k < 3; k++) {
        const double direct = b->balance.direct[k], gathered = b->balance.after[k] - direct;
        const double lost = 0.5 * (b->balance.before[k] + b->balance.after[k]) - gathered;
        const float scale = (float)(lost > 0 ? direct / lost : 1);
        all_direct += direct;
        sum += b->balance.after[k];
        if (b->rounds >= SBL__BOUNCE_SCALED || !(scale > 0)) continue;
        for (i = 0; i < s->leaf_count; i++)
            s->leaves[i].light[k] = b->direct[3 * i + k] + scale * (s->leaves[i].light[k] - b->direct[3 * i + k]);
    }
    ratio = b->change > 0 ? SBL__MIN(b->balance.change / b->change, 0.999) : 0.999;
    b->change = b->balance.change;
    b->rounds++;
    if (b->rounds < SBL__BOUNCE_SCALED + 2 && b->change > 0) return SBL__BOUNCE_GATHER;
    if (!(b->change * ratio / (1 - ratio) <= SBL__BOUNCE_TOLERANCE * sum) && b->rounds < SBL__BOUNCE_ROUNDS)
        return SBL__BOUNCE_GATHER;
    sbl__bounce_warn(b, all_direct, sum);
    return SBL__BOUNCE_NOISE;
}

/* >>bounce: uncertainty */

/* Sets b->direct to the standard error of a leaf's light with a random sign, estimated from the differences between its
   points or, for a single point, as half the light. */
static sbl_result sbl__bounce_noise(void *work, int at) {
    sbl__bounce *b = (sbl__bounce *)work;
    const sbl__bounce_leaf *leaf = &b->states[at];
    const uint32_t signs = sbl__hash_step(0, (uint32_t)at);
    double sum[3] = { 0, 0, 0 }, squares[3] = { 0, 0, 0 };
    int i, k;
    memcpy(b->solved + 3 * at, b->store->leaves[at].light, 3 * sizeof *b->solved);
    for (i = leaf->first; i < leaf->first + leaf->points; i++) {
        float received[3] = { 0, 0, 0 }, sky[3];
        if (!b->readings[i].valid) continue;
        sbl__bounce_add_received(b, i, received);
        sbl__bounce_sky(b, i, sky);
        for (k = 0; k < 3; k++) {
            const double light = (double)received[k] / SBL__BOUNCE_UNIT + sky[k] + b->readings[i].radiance[k];
            sum[k] += light;
            squares[k] += light * light;
        }
    }
    for (k = 0; k < 3; k++) {
        const double n = leaf->valid, variance = n > 1 ? (squares[k] - sum[k] * sum[k] / n) / (n - 1) / n
                                                       : 0.25 * sum[k] * sum[k];
        b->direct[3 * at + k] = (float)(variance > 0 ? sqrt(variance) : 0) * (signs >> (8 + k) & 1 ? 1.0f : -1.0f);
    }
    return SBL_SUCCESS;
}

/* Replaces the light by its noise, so that further rounds propagate the noise along the same rays. */
static int sbl__bounce_after_noise(void *work) {
    sbl__bounce *b = (sbl__bounce *)work;
    int i;
    for (i = 0; i < b->store->leaf_count; i++)
        memcpy(b->store->leaves[i].light, b->direct + 3 * i, 3 * sizeof *b->direct);
    b->rounds = 0;
    return SBL__BOUNCE_PROPAGATE;
}

static int sbl__bounce_after_propagate(void *work) {
    const int round = ++((sbl__bounce *)work)->rounds;
    return round < SBL__UNCERTAINTY_ROUNDS ? SBL__BOUNCE_PROPAGATE : SBL__BOUNCE_UNCERTAINTY;
}

/* Restores the light. Noise that has arrived from other leaves, relative to the light, is the leaf's uncertainty. */
static sbl_result sbl__bounce_uncertainty(void *work, int at) {
    sbl__bounce *b = (sbl__bounce *)work;
    const float *solved = b->solved + 3 * at, *own = b->direct + 3 * at;
    float *light = b->store->leaves[at].light;
    double uncertainty2 = 0;
    int k;
    for (k = 0; k < 3; k++) {
        const double off = solved[k] > 0 ? ((double)light[k] - own[k]) / solved[k] : 0;
        uncertainty2 += off * off / 3;
        light[k] = solved[k];
    }
    sbl__leaf_set_uncertainty(&b->store->leaves[at],
                              SBL__UNCERTAINTY_STRATA * SBL__MIN(sqrt(uncertainty2), SBL__UNCERTAINTY_MOST));
    return SBL_SUCCESS;
}

static sbl_result sbl__bounce_send(void *work, sbl__slice *slice) {
    const sbl__bounce *b = (const sbl__bounce *)work;
    (void)slice;
    b->core->device.gl.doing = "storing bounced light";
    return sbl__store_send(&b->core->device, b->store, b->geometry);
}

/* >>bounce: light in the air, for objects that the host draws */

/* Begins to measure light with six sensors each at the centre of draw_bounds and half way from there to its corners. */
static int sbl__bounce_after_send(void *work) {
    sbl__bounce *b = (sbl__bounce *)work;
    const sbl__scene *scene = &b->core->scene;
    int i, k;
    if (!scene->draw) return SBL__BOUNCE_DONE;
    memset(b->sites, 0, SBL__AIR_SITES * sizeof *b->sites);
    for (i = 0; i < SBL__AIR_SITES; i++) {
        sbl__site *site = &b->sites[i];
        const int place = i / 6, axis = i % 6 / 2;
        for (k = 0; k < 3; k++) {
            const double t = place == 8 ? 0.5 : place >> k & 1 ? 0.75 : 0.25;
            site->position[k] = (float)((1 - t) * scene->draw_bounds[0][k] + t * scene->draw_bounds[1][k]);
        }
        site->normal[axis] = site->geometric_normal[axis] = i & 1 ? -1.0f : 1.0f;
        site->number = (uint32_t)i;
        site->looks = 1;
    }
    sbl__bounce_measure(b, SBL_MODE_GI, SBL__AIR_SITES);
    return SBL__BOUNCE_AIR;
}

static int sbl__bounce_after_air(void *work) {
    sbl__bounce *b = (sbl__bounce *)work;
    float (*air)[3] = b->store->air;
    int i, k, valid[6] = { 0, 0, 0, 0, 0, 0 };
    memset(air, 0, sizeof b->store->air);
    for (i = 0; i < SBL__AIR_SITES; i++) valid[i % 6] += b->readings[i].valid;
    for (i = 0; i < SBL__AIR_SITES; i++)
        for (k = 0; k < 3 && b->readings[i].valid; k++)
            air[i % 6][k] += b->readings[i].radiance[k] / (float)valid[i % 6];
    return SBL__BOUNCE_DONE;
}

/* >>bounce: beginning, stepping and freeing */

/* Frees everything except points and their hits, which are kept for later changes of lights. */
static void sbl__bounce_free_temporary(const sbl__device *d, sbl__bounce *b) {
    const sbl__patching *p = &b->patching;
    void *const blocks[] = { p->places.slots, p->ends.slots, p->welded, p->corners, p->parents, p->patches,
                             b->samples.list, b->waiting.list, b->released.list, b->contacts.list, b->sequence,
                             b->sites, b->readings, b->direct, b->solved };
    int i;
    for (i = 0; i < SBL__COUNT(blocks); i++) sbl__free(d->base, blocks[i]);
    sbl__table_delete(d, &b->casts);
    sbl__blocks_free(d, &b->blocks);
    sbl__job_free(d, &b->job);
    memset(&b->patching, 0, sizeof *b - offsetof(sbl__bounce, patching));
}

/* Frees all data of the filling of the store: what is being built, and the points and hits that a ready store keeps. */
static void sbl__bounce_end(sbl__core *c) {
    sbl__bounce *b = c->bounce;
    if (!b) return;
    sbl__bounce_free_temporary(&c->device, b);
    sbl__free(&c->base, b->points);
    sbl__free(&c->base, b->states);
    sbl__free(&c->base, b->hits.list);
    sbl__free(&c->base, b);
    c->bounce = NULL;
}

/* Returns the filling in progress or a new one; NULL: out of memory. Points and hits outlive changes of lights. */
static sbl__bounce *sbl__bounce_resume(sbl__core *c) {
    sbl__bounce *b;
    if (c->bounce && c->bounce->surfaces != c->scene.surfaces) sbl__bounce_end(c);
    if (!c->bounce) c->bounce = (sbl__bounce *)sbl__alloc(&c->base, 1, sizeof *c->bounce);
    b = c->bounce;
    if (!b) return NULL;
    if (b->scene != c->scene.version && b->stages.stage >= SBL__BOUNCE_SITES) {
        b->stages.stage = SBL__BOUNCE_SITES;
        b->stages.at = b->rounds = 0;
        b->change = 0;
    }
    b->core = c;
    b->store = &c->scene.store;
    b->geometry = &c->scene.geometry;
    b->surfaces = c->scene.surfaces;
    b->scene = c->scene.version;
    return b;
}

/* Fills the store, piece by piece. Returns SBL_SUCCESS when the store is ready. */
static sbl_result sbl__bounce_step(sbl__core *c, sbl__slice *slice) {
    static const sbl__stage_row table[] = {
        { sbl__bounce_patches, NULL, NULL, NULL },
        { sbl__bounce_grid, NULL, NULL, NULL },
        { NULL, NULL, sbl__bounce_sample, sbl__bounce_triangles },
        { sbl__bounce_cast_samples, NULL, NULL, NULL },
        { NULL, sbl__bounce_after_place, sbl__bounce_place, sbl__bounce_queued },
        { sbl__bounce_cast_contacts, NULL, NULL, NULL },
        { NULL, sbl__bounce_after_cuts, sbl__bounce_cuts, sbl__bounce_uncut_leaves },
        { sbl__bounce_cast_points, sbl__bounce_after_rays, NULL, NULL },
        { NULL, sbl__bounce_after_relocate, sbl__bounce_relocate, sbl__bounce_points },
        { NULL, NULL, sbl__bounce_sort, sbl__bounce_points },
        { NULL, NULL, sbl__bounce_link, sbl__bounce_points },
        { sbl__bounce_allocate, sbl__bounce_after_sites, sbl__bounce_site, sbl__bounce_points },
        { sbl__bounce_run_job, NULL, NULL, NULL },
        { NULL, NULL, sbl__bounce_direct, sbl__bounce_leaves },
        { NULL, sbl__bounce_after_gather, sbl__bounce_gather, sbl__bounce_leaves },
        { NULL, sbl__bounce_after_noise, sbl__bounce_noise, sbl__bounce_leaves },
        { NULL, sbl__bounce_after_propagate, sbl__bounce_gather, sbl__bounce_leaves },
        { NULL, NULL, sbl__bounce_uncertainty, sbl__bounce_leaves },
        { sbl__bounce_send, sbl__bounce_after_send, NULL, NULL },
        { sbl__bounce_run_job, sbl__bounce_after_air, NULL, NULL }
    };
    const double start = sbl__now();
    sbl__store *s = &c->scene.store;
    sbl_result result = SBL_ERROR_OUT_OF_MEMORY;
    if (!s->ready && sbl__bounce_resume(c))
        result = sbl__stages_step(&c->bounce->stages, table, SBL__COUNT(table), c->bounce, slice);
    if (s->ready) result = SBL_SUCCESS;
    else if (result == SBL_SUCCESS) {
        sbl__bounce_free_temporary(&c->device, c->bounce);
        s->ready = 1;
        s->made_for = s->max_leaves;
    } else if (result != SBL_UNFINISHED) sbl__bounce_end(c);
    c->stats.seconds.bounce += sbl__now() - start;
    c->stats.store.cells = s->leaf_count;
    return result;
}

/* Estimates how much of the store is done, 0 to 1; less than before after a restart. Until the number of points is
   known, it is assumed to be the number for which the size of cells was chosen, or a quarter more than there are. */
static float sbl__bounce_progress(const sbl__core *c) {
    const sbl__bounce *b = c->bounce;
    float points, cast;
    if (c->scene.store.ready || !b) return c->scene.store.ready ? 1.0f : 0.0f;
    points = (float)SBL__FILL_AIM * (float)(SBL__BOUNCE_POINTS * b->store->max_leaves);
    cast = (float)b->points_cast;
    if (b->stages.stage == SBL__BOUNCE_CAST_POINTS)
        cast = SBL__MAX(cast, (float)b->stages.at / SBL__BOUNCE_RAYS);
    return b->stages.stage < SBL__BOUNCE_SITES
               ? SBL__BOUNCE_CAST * cast / SBL__MAX(SBL__MAX(points, 1.25f * (float)b->point_count), 1.0f)
         : b->stages.stage == SBL__BOUNCE_SITES ? SBL__BOUNCE_CAST
         : b->stages.stage == SBL__BOUNCE_LIGHT
               ? SBL__BOUNCE_CAST + (SBL__BOUNCE_LIT - SBL__BOUNCE_CAST) * sbl__job_progress(&b->job)
               : SBL__BOUNCE_LIT;
}

/* Prepares what a measurement needs, piece by piece: hierarchy and lamps for rays, the store for bounced light. */
static sbl_result sbl__prepare(sbl__core *c, const sbl__measurement *s, sbl__slice *slice) {
    const sbl__hierarchy *h = &c->scene.hierarchy;
    const int rays = s->options.mode != SBL_MODE_PAPER;
    const sbl_result result = rays ? sbl__scene_step(&c->device, &c->scene, slice) : SBL_SUCCESS;
    if (result != SBL_SUCCESS) return result;
    c->stats.scene.bvh_seconds = h->seconds;
    c->stats.scene.lamps = rays ? c->scene.lights.leaves : 0;
    c->stats.scene.bvh_bytes = h->node_table.buffer.bytes + h->triangle_table.buffer.bytes +
                               h->node_table.texels.bytes + h->triangle_table.texels.bytes;
    return s->options.mode == SBL_MODE_GI ? sbl__bounce_step(c, slice) : SBL_SUCCESS;
}

/* ======================================================================================================== >>saved
   Writes a header, the store and a checksum to a stream, and reads them if they are valid and belong to the scene. */

#define SBL__SAVED_NAME "sblstore"
#define SBL__SAVED_VERSION 5u
#define SBL__SAVED_ORDER 0x01020304u   /* tells the byte order */
#define SBL__SAVED_SEED 0xcbf29ce484222325u
#define SBL__SAVED_CELLS (1 << 22)     /* maximum number of slots and of cuts in a stream; leaves: half of it */

/* The parts of a scene that stored light depends on. Each has its own hash, so that a message can tell which differ. */
enum { SBL__SAVED_MESHES, SBL__SAVED_MATERIALS, SBL__SAVED_LIGHTS, SBL__SAVED_SKY, SBL__SAVED_PARTS };

/* Streams of all versions begin with name, version and order. */
typedef struct sbl__saved {
    char name[8];
    uint32_t version, order;
    uint64_t parts[SBL__SAVED_PARTS];  /* hashes of the scene, see sbl__saved_scene */
    int32_t made_for;                  /* sbl__store.made_for */
    int32_t triangles, cells, cuts, leaves, unused;
} sbl__saved;

/* Hashes everything that stored light depends on, part by part. */
static void sbl__saved_scene(const sbl__scene *s, uint64_t parts[SBL__SAVED_PARTS]) {
    const sbl__geometry *g = &s->geometry;
    const sbl__environment *e = &s->environment;
    uint64_t *meshes = &parts[SBL__SAVED_MESHES], *materials = &parts[SBL__SAVED_MATERIALS];
    uint64_t *sky = &parts[SBL__SAVED_SKY];
    const uint64_t seed = SBL__SAVED_SEED;
    int i;
    *meshes = sbl__hash_bytes(seed, g->vertices, (size_t)g->vertex_count * sizeof *g->vertices);
    *meshes = sbl__hash_bytes(*meshes, g->attributes, (size_t)g->vertex_count * sizeof *g->attributes);
    *meshes = sbl__hash_bytes(*meshes, g->indices, 3 * (size_t)g->triangle_count * sizeof *g->indices);
    if (s->draw) *meshes = sbl__hash_bytes(*meshes, s->draw_bounds, sizeof s->draw_bounds);
    *materials = sbl__hash_bytes(seed, &s->textures.hash, sizeof s->textures.hash);
    for (i = 0; i < g->mesh_count; i++)
        *materials = sbl__hash_bytes(*materials, &g->objects[i], offsetof(sbl__object, id));
    parts[SBL__SAVED_LIGHTS] = sbl__hash_bytes(seed, s->lights.list,
                                               (size_t)s->lights.count * sizeof *s->lights.list);
    *sky = sbl__hash_bytes(seed, e->sky, sizeof e->sky);
    *sky = sbl__hash_bytes(*sky, e->axes, sizeof e->axes);
    if (e->pixels) *sky = sbl__hash_bytes(*sky, e->pixels, 4 * sizeof(float) * (size_t)e->width * (size_t)e->height);
}

/* A stream that the host reads (get) or writes (put); the other function is NULL. */
typedef struct sbl__saved_stream {
    sbl_read_function get;
    sbl_write_function put;
    void *user;
    uint64_t sum;                      /* hash of all data so far */
} sbl__saved_stream;

/* Reads or writes a block of data. Returns 0 if the stream fails or ends. */
static int sbl__saved_transfer(sbl__saved_stream *s, void *data, size_t bytes) {
    if (bytes && (s->get ? s->get(data, bytes, s->user) : s->put(data, bytes, s->user)) != bytes) return 0;
    s->sum = sbl__hash_bytes(s->sum, data, bytes);
    return 1;
}

/* Reads or writes what follows the header: the grid, light in the air and the arrays. */
static int sbl__saved_store(sbl__saved_stream *stream, sbl__store *s, int triangles) {
    return sbl__saved_transfer(stream, s->origin, sizeof s->origin) &&
           sbl__saved_transfer(stream, &s->length, sizeof s->length) &&
           sbl__saved_transfer(stream, s->air, sizeof s->air) &&
           sbl__saved_transfer(stream, s->patches, (size_t)triangles * sizeof *s->patches) &&
           sbl__saved_transfer(stream, s->cells, (size_t)s->cell_room * sizeof *s->cells) &&
           sbl__saved_transfer(stream, s->cuts, (size_t)s->cut_count * sizeof *s->cuts) &&
           sbl__saved_transfer(stream, s->leaves, (size_t)s->leaf_count * sizeof *s->leaves);
}

static int sbl__saved_write(sbl__scene *s, sbl_write_function put, void *user) {
    sbl__saved_stream stream = { NULL, put, user, SBL__SAVED_SEED };
    sbl__saved header;
    memset(&header, 0, sizeof header);
    memcpy(header.name, SBL__SAVED_NAME, sizeof header.name);
    header.version = SBL__SAVED_VERSION;
    header.order = SBL__SAVED_ORDER;
    sbl__saved_scene(s, header.parts);
    header.made_for = s->store.made_for;
    header.triangles = s->geometry.triangle_count;
    header.cells = s->store.cell_room;
    header.cuts = s->store.cut_count;
    header.leaves = s->store.leaf_count;
    return sbl__saved_transfer(&stream, &header, sizeof header) &&
           sbl__saved_store(&stream, &s->store, header.triangles) &&
           sbl__saved_transfer(&stream, &stream.sum, sizeof stream.sum);
}

/* What is wrong with a stream. why: the words, or "" if nothing is wrong. item: the log item of the message */
typedef struct sbl__saved_fault { char why[128]; sbl_log_item item; } sbl__saved_fault;

/* Notes what is wrong with a stream. */
static void sbl__saved_refuse(sbl__saved_fault *fault, sbl_log_item item, const char *why) {
    snprintf(fault->why, sizeof fault->why, "%s", why);
    fault->item = item;
}

/* Checks that a header belongs to this scene. Otherwise the fault names the parts of the scene that differ. */
static void sbl__saved_compare(const sbl__saved *header, const sbl__scene *s, sbl__saved_fault *fault) {
    static const char *const words[SBL__SAVED_PARTS] = { "other meshes", "other materials or textures", "other lights",
                                                         "another sky" };
    uint64_t parts[SBL__SAVED_PARTS];
    int i, differ = 0, named = 0;
    size_t length = 0;
    sbl__saved_scene(s, parts);
    if (header->triangles != s->geometry.triangle_count) parts[SBL__SAVED_MESHES] = ~header->parts[SBL__SAVED_MESHES];
    for (i = 0; i < SBL__SAVED_PARTS; i++) differ += parts[i] != header->parts[i];
    if (!differ) return;
    sbl__saved_refuse(fault, SBL_LOG_ITEM_OTHER_STORE, "it was stored for a scene with ");
    for (i = 0; i < SBL__SAVED_PARTS; i++) {
        if (parts[i] == header->parts[i]) continue;
        length = strlen(fault->why);
        snprintf(fault->why + length, sizeof fault->why - length, "%s%s",
                 !named ? "" : named == differ - 1 ? " and " : ", ", words[i]);
        named++;
    }
}

/* Reads a header up to the part that depends on the scene, and checks it. */
static void sbl__saved_begin(sbl__saved_stream *stream, sbl__saved *header, sbl__saved_fault *fault) {
    const int32_t most = SBL__SAVED_CELLS;
    int32_t cells;
    memset(header, 0, sizeof *header);
    if (!sbl__saved_transfer(stream, header, sizeof header->name) ||
        memcmp(header->name, SBL__SAVED_NAME, sizeof header->name))
        sbl__saved_refuse(fault, SBL_LOG_ITEM_INVALID_STORE, "it is not stored light of sbl.h");
    else if (!sbl__saved_transfer(stream, (char *)header + sizeof header->name, sizeof *header - sizeof header->name))
        sbl__saved_refuse(fault, SBL_LOG_ITEM_INVALID_STORE, "it ends too soon");
    else if (header->order != SBL__SAVED_ORDER)
        sbl__saved_refuse(fault, SBL_LOG_ITEM_OTHER_STORE, "it was written on a machine with another byte order");
    else if (header->version != SBL__SAVED_VERSION)
        sbl__saved_refuse(fault, SBL_LOG_ITEM_OTHER_STORE, "it was written by another version of sbl.h");
    cells = header->cells;
    if (!fault->why[0] && (cells < 1 || cells > most || (cells & (cells - 1)) || header->cuts < 0 ||
                           header->cuts > most || header->leaves < 0 || header->leaves > most / 2 ||
                           header->triangles < 0 || header->made_for < 1))
        sbl__saved_refuse(fault, SBL_LOG_ITEM_INVALID_STORE, "it is damaged");
}

/* Returns 1 if a reference leads to a leaf or cut that exists. The sides of cut number `from` may only lead to later
   cuts, so that no cycle exists; other references have `from` -1. */
static int sbl__saved_leads(const sbl__store *s, uint32_t reference, int from) {
    const uint32_t cut = reference & ~SBL__CELL_CUT;
    if (reference < SBL__CELL_CUT) return reference <= (uint32_t)s->leaf_count;
    return cut < (uint32_t)s->cut_count && (from < 0 || cut > (uint32_t)from);
}

static int sbl__saved_valid(const sbl__store *s) {
    int i, k;
    if (!sbl__all_finite(s->origin, 3) || !sbl__between(&s->length, FLT_MIN, FLT_MAX) ||
        !sbl__all_finite(&s->air[0][0], 18)) return 0;
    for (i = 0; i < s->cell_room; i++) if (!sbl__saved_leads(s, s->cells[i].reference, -1)) return 0;
    for (i = 0; i < s->cut_count; i++) {
        const sbl__cut *cut = &s->cuts[i];
        if (!sbl__saved_leads(s, cut->sides[0], i) || !sbl__saved_leads(s, cut->sides[1], i)) return 0;
        if (!sbl__all_finite(cut->normal, 4)) return 0;  /* normal and distance */
    }
    for (i = 0; i < s->leaf_count; i++)
        for (k = 0; k < 3; k++) if (!sbl__between(&s->leaves[i].light[k], 0, FLT_MAX)) return 0;
    return 1;
}

/* Reads the checksum at the end of a stream. Returns what is wrong with the stream, or NULL. */
static const char *sbl__saved_end(sbl__saved_stream *stream) {
    const uint64_t sum = stream->sum;
    uint64_t end;
    if (!sbl__saved_transfer(stream, &end, sizeof end)) return "it ends too soon";
    return end == sum ? NULL : "it is damaged";
}

/* Reads what follows the header of another scene's stream, without keeping it. Returns what is wrong with the stream,
   or NULL. */
static const char *sbl__saved_skip(sbl__saved_stream *stream, const sbl__saved *header) {
    uint64_t left = sizeof ((sbl__store *)0)->origin + sizeof ((sbl__store *)0)->length +
                    sizeof ((sbl__store *)0)->air + (uint64_t)header->triangles * sizeof(uint32_t) +
                    (uint64_t)header->cells * sizeof(sbl__cell_slot) + (uint64_t)header->cuts * sizeof(sbl__cut) +
                    (uint64_t)header->leaves * sizeof(sbl__leaf);
    uint32_t block[1024];
    while (left) {
        const size_t bytes = left < sizeof block ? (size_t)left : sizeof block;
        if (!sbl__saved_transfer(stream, block, bytes)) return "it ends too soon";
        left -= bytes;
    }
    return sbl__saved_end(stream);
}

/* Reads a store into s, which is empty. */
static sbl_result sbl__saved_read(const sbl__device *d, const sbl__scene *scene, sbl__store *s, sbl_read_function get,
                                  void *user, sbl__saved_fault *fault) {
    sbl__saved_stream stream = { get, NULL, user, SBL__SAVED_SEED };
    sbl__saved header;
    const char *why = NULL;
    sbl__saved_begin(&stream, &header, fault);
    if (fault->why[0]) return SBL_ERROR_INVALID_ARGUMENT;
    sbl__saved_compare(&header, scene, fault);
    if (fault->why[0]) why = sbl__saved_skip(&stream, &header);
    else {
        s->patches = (uint32_t *)sbl__alloc(d->base, (size_t)header.triangles, sizeof *s->patches);
        s->cells = (sbl__cell_slot *)sbl__alloc(d->base, (size_t)header.cells, sizeof *s->cells);
        s->cuts = (sbl__cut *)sbl__alloc(d->base, (size_t)header.cuts, sizeof *s->cuts);
        s->leaves = (sbl__leaf *)sbl__alloc(d->base, (size_t)header.leaves, sizeof *s->leaves);
        if (!s->patches || !s->cells || !s->cuts || !s->leaves) return SBL_ERROR_OUT_OF_MEMORY;
        s->made_for = header.made_for;
        s->cell_room = header.cells;
        s->cut_count = s->cut_room = header.cuts;
        s->leaf_count = s->leaf_room = header.leaves;
        why = sbl__saved_store(&stream, s, header.triangles) ? sbl__saved_end(&stream) : "it ends too soon";
        if (!why && !sbl__saved_valid(s)) why = "it is damaged";
    }
    if (why) sbl__saved_refuse(fault, SBL_LOG_ITEM_INVALID_STORE, why);
    return fault->why[0] ? SBL_ERROR_INVALID_ARGUMENT : SBL_SUCCESS;
}

/* Replaces the scene's store with a store from a stream. On failure the scene keeps its store. */
static sbl_result sbl__saved_load(sbl__core *c, sbl_read_function get, void *user) {
    sbl__scene *scene = &c->scene;
    const sbl__geometry *g = &scene->geometry;
    sbl__saved_fault fault;
    sbl__store s;
    sbl_result result;
    memset(&fault, 0, sizeof fault);
    memset(&s, 0, sizeof s);
    s.max_leaves = scene->store.max_leaves;
    result = sbl__saved_read(&c->device, scene, &s, get, user, &fault);
    if (result == SBL_SUCCESS && !g->wide && g->triangle_count / 4 + 1 + s.cell_room / 2 + 2 * s.cut_count +
                                             s.leaf_count > c->device.gl.capabilities.max_texture_buffer_size) {
        sbl__saved_refuse(&fault, SBL_LOG_ITEM_OTHER_STORE, "it is larger than this driver's tables");
        result = SBL_ERROR_UNSUPPORTED;
    }
    if (fault.why[0]) sbl__log(&c->base, SBL_LOG_ERROR, fault.item, "sbl_load_store: %s", fault.why);
    c->device.gl.doing = "storing bounced light";
    if (result == SBL_SUCCESS) result = sbl__store_send(&c->device, &s, g);
    if (result != SBL_SUCCESS) {
        sbl__store_free(&c->device, &s);
        return result;
    }
    if (s.made_for < s.max_leaves)
        sbl__log(&c->base, SBL_LOG_WARNING, SBL_LOG_ITEM_COARSE_STORE, "sbl_load_store: it was made with at most %d "
                 "cells, and this scene may have %d, which would be finer", s.made_for, s.max_leaves);
    sbl__bounce_end(c);
    sbl__store_free(&c->device, &scene->store);
    scene->store = s;
    scene->store.ready = 1;
    return SBL_SUCCESS;
}

/* ======================================================================================================== >>refine
   Adaptive placement of sensors (section III-G): where sensors stand, how many looks each takes, what light the other
   pixels get from them, and how large the remaining error is likely to be.

   A tile is a rectangle of pixels with sensors at its four corners; neighbouring tiles share corners. Each round lists
   sites for a job (COLLECT), runs the job (SENSE), takes its readings (TAKE) and predicts the error of every tile
   (WEIGH), which has two parts:

       bias    the error of interpolation. It is estimated from second differences of light between sensors, and from
               sensors that splits of neighbours put on the tile's edges
       noise   the part of the corners' noise that remains after interpolation and the filter. In a wide tile each
               sensor stands for many pixels; in a narrow tile the filter takes the mean of many sensors

   The uncertainty of stored light is a third part, which refinement cannot reduce. While the sum exceeds the target
   error, SPEND buys what reduces the error most for its cost: splits of tiles, or more looks of sensors.
   With a threshold (always in SBL_MODE_PAPER) a tile is split where its corners differ by more than the threshold.

       +-------+-------+      +---+---+-------+      o sensor of the first level
       o       o       o      o   *   o       o      * sensor that the split of the left tile adds; the interpolation
       |       |       |      *   *   *       |        of the right tile is tested against the one on the common edge
       o       o       o      o   *   o       o

   Everything except jobs runs on the CPU, in slices. "Relative" luminances and errors are shares of the picture's mean
   luminance. A name that ends in 2 holds a squared error. Later rooms only call functions; they read no field of
   sbl__refine. */

enum { SBL__TOUCHED = 1, SBL__HIDDEN };  /* occlusion of a texel of a lightmap, see sbl__refine_occlusion */

typedef struct sbl__pixel {
    float position[3], normal[3], geometric_normal[3];
    float offset;             /* distance of the pixel's sensor from the surface */
    float radiance[3];        /* R, if `sensed`: mean of the looks of the pixel's sensor, or from the store */
    double variance;          /* variance of the luminance of one look */
    float error;              /* predicted standard error of the pixel's luminance in the picture */
    float stored[3];          /* value of R at this pixel according to the store, see >>store */
    float uncertainty;        /* standard error of the pixel's luminance that errors of the store cause */
    uint32_t id;              /* number of the surface; 0: the pixel shows no surface */
    int look;                 /* index of the sensor's first look among all looks of its job */
    int looks, wanted;        /* number of looks taken so far; number of looks to be taken in total */
    short round;              /* last round that read the sensor */
    unsigned char level;      /* 0: the pixel has no sensor; otherwise 1 + level of the tile that put a sensor here */
    unsigned char sensed;     /* 1: radiance is known, from the pixel's own sensor or from the store */
    unsigned char invalid;    /* 1: the sensor is stuck inside geometry, or occlusion makes its light unfit to show */
    unsigned char occlusion;  /* lightmaps only: SBL__HIDDEN: the texel lies inside or under something;
                                 SBL__TOUCHED: something is close to it; 0: neither */
    unsigned char queued;     /* 1: the pixel is among the sites of the current job */
} sbl__pixel;

/* Occlusion. A texel is hidden if surfaces cover more than HIDDEN_SHARE of its hemisphere, at a mean distance below
   HIDDEN_NEAR * distance_limit; it is touched if a surface is closer than HIDDEN_TOUCH * distance_limit. */
#define SBL__HIDDEN_SHARE 0.9f
#define SBL__HIDDEN_NEAR 0.45f
#define SBL__HIDDEN_TOUCH 0.15f
#define SBL__HIDDEN_REACH 2       /* distance_limit / width of a texel */

/* Interpolation. Errors are root mean squares. STEP_ERROR, CURVE_ERROR: error of interpolation along an edge / second
   difference at its ends, if light has a step, or if it is a parabola that sbl__edge_parabola corrects; measured on
   shadows of lamps with tiles of 2 to 16 pixels. */
#define SBL__COVERAGE 0.75f             /* a tile is split if its corners give a pixel less weight (sbl__mix) */
#define SBL__EXTRAPOLATED_SPAN 4        /* largest span of tiles that use extrapolated light, pixels */
#define SBL__STEP_ERROR 0.29f
#define SBL__CURVE_ERROR 0.1f
#define SBL__EXTRAPOLATION_ERROR 0.35f  /* error of extrapolated light / second difference of the light it continues */
#define SBL__SILHOUETTE_ERROR 0.05f     /* least error of extrapolated light / light, or mean R if larger */
#define SBL__CONTACT_ERROR 0.12f        /* as SILHOUETTE_ERROR, if the other surface is near: it may cast a shadow */
#define SBL__CONTACT_DISTANCE 2.5f      /* largest distance of a near surface / distance between neighbouring sensors */
#define SBL__PIXEL_ERROR 0.15f          /* error of a pixel that no estimate explains / error of the picture */
#define SBL__NOISE_IN_BIAS 0.75f        /* part of raw_bias2 due to noise / variance of the sensors */
#define SBL__NOISE_IN_SPLITS 1.25f      /* as NOISE_IN_BIAS, for gains of splits; larger, as looks reduce noise too */
/* Noise of sensors. */
#define SBL__LEAST_NOISE 1e-12f         /* least noise of a surface in the radiance map; 0 marks empty pixels */
#define SBL__NOISE_WEIGHT 4             /* multiple of the variance that sbl__differ adds to the squared threshold */
#define SBL__LOOKS_GAIN 0.4f            /* variance of 2n looks / of n looks; below 0.5, as looks share a sequence */
#define SBL__LOOKS_GAIN_NEXT (0.5f * SBL__LOOKS_GAIN)  /* gain per look from 2n to 4n looks / from n to 2n looks */
#define SBL__LOOKS_GROWTH 8             /* largest factor by which a sensor's looks grow in one round */
#define SBL__DOUBLINGS 10               /* number of powers of two from 1 to SBL__MAX_LOOKS, which is 2^9 */
#define SBL__LOOKS_DIFFERENCE 1.1       /* variance of the difference between earlier and later looks of a sensor / sum
                                           of both variances; above 1, as later points complement earlier points */
#define SBL__LOOKS_COMPARED 64          /* least number of differences from which a variance share is corrected */
#define SBL__LOOKS_CORRECTION_MIN 0.5   /* least factor by which a variance share is corrected */
#define SBL__LOOKS_CORRECTION_MAX 8.0   /* largest factor by which a variance share is corrected */
#define SBL__PARENT_WEIGHT 0.6f         /* weight of the parent tile in a tile's variance: four sensors are few */
/* What a round buys: splits of tiles and looks of sensors. */
#define SBL__MAX_ROUNDS 40              /* after so many rounds, only necessary splits are bought */
#define SBL__JOB_LOOKS (1 << 21)        /* approximate number of looks in one job */
#define SBL__AIM_BELOW 0.9              /* a round aims at this multiple of the squared target error */
#define SBL__AIM_SHARE 0.6              /* a round aims at no less than this share of the present squared error, since
                                           new readings may change what is worth buying */
#define SBL__AIM_LEAST 0.7              /* share of the squared target error that bias and noise may always have,
                                           however large the uncertainty of stored light */
#define SBL__SPLIT_COST 3               /* cost of a split in sensors: it adds five, but neighbours share most */
#define SBL__SPLIT_GAIN 0.875f          /* share of the squared error of interpolation that a split removes */
#define SBL__DIFFERENCE_FLOOR 0.02f     /* share of the mean luminance that sbl__differ adds to the light it compares */
#define SBL__GAIN_FLOOR 0.1f            /* worth = gain / (relative luminance + this): errors show in dark places */
#define SBL__EXPECT_LOOKS 0.7           /* usual number of looks per pixel in the end; 0.25 to 1.9 were measured */
#define SBL__EXPECT_SHARE 0.6           /* measured (0.45 to 0.9): looks in the end / looks if all tiles were narrow */
#define SBL__EXPECT_KNOWN 0.25          /* number of looks per pixel at which most tiles have been found that need
                                           sensors */
#define SBL__GAIN_BINS 512              /* bins of the histogram of gains by worth, four to an octave */
/* To prevent ragged shadows, a tile is always split if its error exceeds target_error * TILE_ERROR_MAX * (relative
   luminance + TILE_ERROR_FLOOR). */
#define SBL__TILE_ERROR_MAX 5.0f
#define SBL__TILE_ERROR_FLOOR 0.1f

/* Two pixels: the ends of a line, or the upper left and lower right corners of a rectangle. */
typedef struct sbl__range { int x[2], y[2]; } sbl__range;

typedef struct sbl__tile {
    sbl__range area;
    int level, split;
    int must_split;           /* 1: the corners give some pixels too little weight, see SBL__COVERAGE */
    int parent;               /* index of the tile whose split made this one, or -1 */
    int looks;                /* number of looks that new sensors at the tile's corners begin with */
    int pixels;               /* number of pixels that the tile fills in and that show a surface */
    float uncovered;          /* mean over all `pixels` of the bilinear weight of corners whose light they cannot use */
    float raw_bias2;          /* squared error of interpolation, estimated from light on the edges, noise included */
    float unseen_bias2;       /* part of raw_bias2 for changes of light between the last sensors and silhouettes */
    float bias2, noise2;      /* mean relative squared errors of its pixels by interpolation, and by noise */
    float light, variance;    /* mean luminance of the corners; mean relative variance of one look of their sensors */
    float split_worth;        /* worth of a split, see SBL__GAIN_FLOOR; FLT_MAX: the split is necessary */
    float look_worth;         /* worth of doubling the looks of the corners' sensors */
} sbl__tile;

typedef struct sbl__refine {
    sbl__core *core;
    sbl__measurement *measurement;  /* how sensors measure; sbl__refine_after_weigh may give looks more rays */
    sbl__spec *spec;
    sbl__stages stages;
    int width, height;
    int tile_size;            /* width and height of first-level tiles */
    int geometry_aware;       /* 0 in SBL_MODE_PAPER: the threshold is absolute, and an id is one smooth surface */
    float distance_limit;     /* see sbl__spec.distance_limit; 0: no test for occlusion */
    double lit, lit_backs;    /* number of sensors with R above 0 so far; sum of sbl_reading.back_share over them */
    float threshold;          /* see sbl__differ; 0: tiles are split by predicted gain */
    float target_error;       /* 0: refine until nothing is left to buy */
    float smoothing;          /* effective number of pixels that the filter averages, see sbl__filter_pixels */
    sbl__pixel *pixels;
    size_t harmonics;         /* floats of one pixel in layers 1 and up of light, 3 per layer */
    float *layers;            /* light of layers 1 and up (harmonics, see SBL__LAYERS): all layers of a pixel, then
                                 those of the next; layer 0 is sbl__pixel.radiance */
    sbl__tile *tiles;
    int tile_count, tile_room;
    int first_new;            /* index of the first tile that has not been weighed yet */
    int row;                  /* next row of pixels of the tile that the COUNT stage is at */
    int rounds, weighed;      /* number of rounds that are over; 1: errors have been predicted */
    int listed;               /* number of tiles, or in COLLECT_SCOUTS of guides, whose sites this round has listed */
    sbl__site *sites;         /* sites of the job; site i belongs to pixel sites[i].number */
    sbl_reading *readings;
    float *reading_layers;    /* layers 1 and up of the readings, site after site */
    int site_count, site_room, reading_room, reading_layer_room, look_count;
    sbl__guides guides;       /* guides for the sensors' rays, used if spec->guided is set */
    int64_t looks_taken;
    float mean[3], luminance; /* mean of R over the picture, and its luminance */
    double sum[3], pixels_summed;  /* for the next mean: sum of R over pixels (round 0: sensors); their number */
    float weights[3];         /* factors that turn a difference in each channel into a relative error */
    float variance_shares[SBL__DOUBLINGS];  /* [k]: variance of a mean of 2^k looks / variance of one look */
    double measured2[SBL__DOUBLINGS];  /* [k]: sum of squared differences between 2^k looks and later looks */
    double expected2[SBL__DOUBLINGS];  /* [k]: expected value of measured2[k] */
    int compared[SBL__DOUBLINGS];      /* [k]: number of differences in measured2[k] */
    double bias2, noise2;     /* sums over pixels of sbl__tile.bias2, and of sbl__tile.noise2 */
    double uncertainty2;      /* sum over pixels of the squared uncertainty of stored light; absolute, not relative */
    double look_variance;     /* relative variance of one look, averaged over the picture */
    double predicted;         /* predicted error of the picture */
    double stored;            /* the part of `predicted` that stored light causes */
    double gains[SBL__GAIN_BINS];  /* histogram by worth: sums of the gains of all possible splits and looks */
    double costs[SBL__GAIN_BINS];  /* histogram by worth: sums of their costs, looks */
    double expected_looks;    /* number of looks that have been taken when refinement ends, as far as is foreseen */
    float least_worth;        /* least worth that is bought in this round */
    int bought;               /* number of tiles split and of sensors given more looks in this round */
} sbl__refine;

static void sbl__refine_free(const sbl__device *d, sbl__refine *r) {
    void *const blocks[] = { r->pixels, r->layers, r->tiles, r->sites, r->readings, r->reading_layers };
    int i;
    for (i = 0; i < SBL__COUNT(blocks); i++) sbl__free(d->base, blocks[i]);
    sbl__guides_free(d, &r->guides);
    memset(r, 0, sizeof *r);
}

static sbl__pixel *sbl__pixel_at(const sbl__refine *r, int x, int y) {
    return &r->pixels[(size_t)y * (size_t)r->width + (size_t)x];
}

/* Like sbl__pixel_at, but returns NULL outside the picture. */
static sbl__pixel *sbl__pixel_inside(const sbl__refine *r, int x, int y) {
    return x >= 0 && y >= 0 && x < r->width && y < r->height ? sbl__pixel_at(r, x, y) : NULL;
}

/* Returns layer `layer` of a pixel's light: 3 floats. */
static const float *sbl__pixel_light(const sbl__refine *r, const sbl__pixel *p, int layer) {
    return layer ? r->layers + (size_t)(p - r->pixels) * r->harmonics + 3 * ((size_t)layer - 1) : p->radiance;
}

static float sbl__abs(float x) { return (float)fabs((double)x); }

/* >>refine: which pixels may share light */

/* CPU version of belongs.glsl: the weight, 0 to 1, with which the light of pixel b may be used for pixel a. */
static float sbl__belongs(const sbl__pixel *a, const sbl__pixel *b, int geometry_aware) {
    float d[3], off, apart, turn, plane;
    int k;
    if (a->id != b->id || a->id == 0) return 0;
    if (!geometry_aware || a == b) return 1;
    turn = (sbl__dot(a->normal, b->normal) - SBL__BELONGS_COSINE) / SBL__BELONGS_TURN;
    if (turn <= 0) return 0;
    turn = SBL__MIN(turn, 1.0f);
    for (k = 0; k < 3; k++) d[k] = b->position[k] - a->position[k];
    off = SBL__MAX(sbl__abs(sbl__dot(d, a->normal)), sbl__abs(sbl__dot(d, b->normal)));
    apart = (float)sqrt((double)sbl__dot(d, d));
    plane = 2 - SBL__BELONGS_OFF * off / SBL__MAX(apart, SBL__DIVISOR_LEAST);
    return turn * turn * SBL__MIN(SBL__MAX(plane, 0.0f), 1.0f);
}

/* Returns 1 if a pixel has light of its own that other pixels may use. */
static int sbl__usable(const sbl__pixel *p) { return p->sensed && !p->invalid; }

static int sbl__connected(const sbl__pixel *a, const sbl__pixel *b, int geometry_aware) {
    return sbl__usable(a) && sbl__usable(b) && sbl__belongs(a, b, geometry_aware) > 0;
}

/* >>refine: noise */

/* Returns the rounded-down binary logarithm of a number of looks. */
static int sbl__doublings(int looks) {
    int k = 0;
    for (; looks > 1 && k < SBL__DOUBLINGS - 1; looks >>= 1) k++;
    return k;
}

/* Records the squared difference between the luminance of `more` new looks and of `before` earlier looks of a sensor;
   more >= before. */
static void sbl__looks_compare(sbl__refine *r, const sbl__pixel *p, int before, int more, double difference2) {
    const int k = sbl__doublings(before);
    const double gain = (double)SBL__LOOKS_GAIN;
    r->measured2[k] += difference2;
    r->expected2[k] += SBL__LOOKS_DIFFERENCE * p->variance * (pow(gain, k) + pow(gain, sbl__doublings(more)));
    r->compared[k]++;
}

/* Computes r->variance_shares from SBL__LOOKS_GAIN and the recorded differences, because the advantage of a Sobol
   sequence over independent points depends on the scene. Without enough differences, the factor of k - 1 corrects k. */
static void sbl__looks_calibrate(sbl__refine *r) {
    double times = 1;
    int k;
    for (k = 0; k < SBL__DOUBLINGS; k++) {
        if (r->compared[k] >= SBL__LOOKS_COMPARED && r->expected2[k] > 0)
            times = SBL__MAX(SBL__MIN(r->measured2[k] / r->expected2[k], SBL__LOOKS_CORRECTION_MAX),
                             SBL__LOOKS_CORRECTION_MIN);
        r->variance_shares[k] = (float)(times * pow((double)SBL__LOOKS_GAIN, k));
    }
}

/* Returns the variance of a mean of `looks` looks as a share of the variance of one look. */
static float sbl__variance_share(const sbl__refine *r, int looks) { return r->variance_shares[sbl__doublings(looks)]; }

/* Returns the variance of a sensor's mean luminance. */
static double sbl__variance(const sbl__refine *r, const sbl__pixel *p) {
    return p->variance * (double)sbl__variance_share(r, p->looks);
}
static float sbl__noise(const sbl__refine *r, const sbl__pixel *p) { return (float)sqrt(sbl__variance(r, p)); }

/* Returns the share of the sensors' variance that remains after interpolation and the filter in a tile of this span.
   Bilinear weights keep 4/9 on average; a filter that averages n pixels keeps a larger share in a wider tile. */
static float sbl__noise_left(const sbl__refine *r, int span) {
    const float area = (float)span * (float)span;
    return span <= 1 ? 1 / r->smoothing : area / (2.25f * area + r->smoothing - 1);
}

/* >>refine: interpolation */

/* Returns the pixel at a tile's upper left (0), upper right (1), lower left (2) or lower right (3) corner. */
static sbl__pixel *sbl__tile_corner(const sbl__refine *r, const sbl__tile *c, int corner) {
    return sbl__pixel_at(r, c->area.x[corner & 1], c->area.y[corner >> 1]);
}

/* Returns the larger of a tile's width and height. A tile of span 1 cannot be split. */
static int sbl__tile_span(const sbl__tile *c) {
    return SBL__MAX(c->area.x[1] - c->area.x[0], c->area.y[1] - c->area.y[0]);
}

typedef struct sbl__edge { sbl__range line; const sbl__pixel *ends[2]; } sbl__edge;

/* Returns an edge of a tile; side 0: top, 1: bottom, 2: left, 3: right. */
static sbl__edge sbl__tile_edge(const sbl__refine *r, const sbl__tile *c, int side) {
    sbl__edge e;
    int end;
    for (end = 0; end < 2; end++) {
        e.line.x[end] = c->area.x[side < 2 ? end : side - 2];
        e.line.y[end] = c->area.y[side < 2 ? side : end];
        e.ends[end] = sbl__pixel_at(r, e.line.x[end], e.line.y[end]);
    }
    return e;
}

/* Returns the sensor `steps` edge lengths beyond an end of an edge, or NULL if `pixel` may not use its light. */
static const sbl__pixel *sbl__sensor_beyond(const sbl__refine *r, const sbl__pixel *pixel, const sbl__edge *e, int end,
                                            int steps) {
    const int *x = e->line.x, *y = e->line.y;
    const int dx = x[end] - x[!end], dy = y[end] - y[!end];
    const sbl__pixel *p = sbl__pixel_inside(r, x[end] + steps * dx, y[end] + steps * dy);
    return p && sbl__usable(p) && sbl__belongs(pixel, p, r->geometry_aware) > 0 ? p : NULL;
}

/* Returns the pixels that a tile fills in: all but its last column and row, unless the picture ends there. */
static sbl__range sbl__tile_pixels(const sbl__refine *r, const sbl__tile *c) {
    sbl__range pixels = c->area;
    pixels.x[1] -= pixels.x[1] < r->width - 1;
    pixels.y[1] -= pixels.y[1] < r->height - 1;
    return pixels;
}

/* A weighted mean of one layer of light over sensors, with its variance. */
typedef struct sbl__mix {
    int layer;
    float share[2];           /* position of the pixel in the tile, 0 to 1 on each axis */
    float light[3];
    float own;                /* weight of corners on the pixel's surface, 0 to 1 */
    float covered;            /* `own` plus the weight of extrapolated corners; 0: there is no light */
    double variance;
} sbl__mix;

static void sbl__mix_add(const sbl__refine *r, sbl__mix *m, const sbl__pixel *p, float weight) {
    const float *light = sbl__pixel_light(r, p, m->layer);
    int k;
    for (k = 0; k < 3; k++) m->light[k] += weight * light[k];
    m->variance += (double)(weight * weight) * sbl__variance(r, p);
}

/* Adds a corner that shows another surface than the pixel. Its light is extrapolated linearly from the adjacent corners
   and the sensors at equal distance beyond them, or copied from an adjacent corner without a sensor beyond it. */
static void sbl__mix_extrapolate(const sbl__refine *r, const sbl__tile *c, int corner, const sbl__pixel *pixel,
                                 float weight, sbl__mix *m) {
    const sbl__pixel *adjacent[2], *beyond[2];
    const int right = corner & 1, lower = corner >> 1;
    float share;
    int axis;
    for (axis = 0; axis < 2; axis++) {
        const sbl__edge e = sbl__tile_edge(r, c, axis ? 2 + right : lower);
        const int end = axis ? !lower : !right;
        adjacent[axis] = e.ends[0] == e.ends[1] ? NULL : sbl__sensor_beyond(r, pixel, &e, end, 0);
        beyond[axis] = adjacent[axis] ? sbl__sensor_beyond(r, pixel, &e, end, 1) : NULL;
    }
    share = weight / (adjacent[0] && adjacent[1] ? 2.0f : 1.0f);
    for (axis = 0; axis < 2; axis++) {
        if (!adjacent[axis]) continue;
        sbl__mix_add(r, m, adjacent[axis], beyond[axis] ? 2 * share : share);
        if (beyond[axis]) sbl__mix_add(r, m, beyond[axis], -share);
        m->covered += share;
    }
}

/* Clamps extrapolated light to 0 or more, except in layers of signed values. */
static float sbl__clamp_light(int layer, float light) { return layer ? light : SBL__MAX(light, 0.0f); }

/* Interpolates a layer of light at pixel (x, y) from a tile's corners. */
static void sbl__interpolate(const sbl__refine *r, const sbl__tile *c, int x, int y, int layer, sbl__mix *m) {
    const sbl__pixel *pixel = sbl__pixel_at(r, x, y);
    const sbl__range *a = &c->area;
    const float *f = m->share;
    int corner, k;
    memset(m, 0, sizeof *m);
    m->layer = layer;
    if (a->x[1] > a->x[0]) m->share[0] = (float)(x - a->x[0]) / (float)(a->x[1] - a->x[0]);
    if (a->y[1] > a->y[0]) m->share[1] = (float)(y - a->y[0]) / (float)(a->y[1] - a->y[0]);
    for (corner = 0; corner < 4; corner++) {
        const sbl__pixel *p = sbl__tile_corner(r, c, corner);
        float weight = (corner & 1 ? f[0] : 1 - f[0]) * (corner & 2 ? f[1] : 1 - f[1]), belongs;
        if (weight <= 0) continue;
        belongs = sbl__usable(p) ? sbl__belongs(pixel, p, r->geometry_aware) : 0;
        if (belongs > 0) {
            sbl__mix_add(r, m, p, weight * belongs);
            m->own += weight * belongs;
            m->covered += weight * belongs;
        } else if (r->geometry_aware) sbl__mix_extrapolate(r, c, corner, pixel, weight, m);
    }
    if (!(m->covered > 0)) return;
    for (k = 0; k < 3; k++) m->light[k] = sbl__clamp_light(layer, m->light[k] / m->covered);
    m->variance /= (double)m->covered * (double)m->covered;
}

/* Computes the second difference of a layer of light at each end of an edge, from both ends and the sensor one length
   beyond that end. The value at an end without a sensor beyond it is the opposite of the other end's value or, without
   any such sensor, of the difference between the ends, as at a step. Returns 1 if the ends' sensors may share light. */
static int sbl__edge_curvature(const sbl__refine *r, const sbl__edge *e, int layer, float out[2][3]) {
    const int length = e->line.x[1] - e->line.x[0] + e->line.y[1] - e->line.y[0];
    const float *light[2] = { sbl__pixel_light(r, e->ends[0], layer), sbl__pixel_light(r, e->ends[1], layer) };
    int known[2] = { 0, 0 }, end, k;
    memset(out, 0, 2 * sizeof *out);
    if (!sbl__connected(e->ends[0], e->ends[1], 1)) return 0;
    for (end = 0; end < 2 && length > 1 && r->geometry_aware; end++) {
        const sbl__pixel *p = sbl__sensor_beyond(r, e->ends[end], e, end, 1);
        known[end] = p != NULL;
        for (k = 0; k < 3 && p; k++)
            out[end][k] = sbl__pixel_light(r, p, layer)[k] - 2 * light[end][k] + light[!end][k];
    }
    for (k = 0; k < 3; k++) {
        if (!known[0] && !known[1]) out[1][k] = light[1][k] - light[0][k];
        if (!known[0] || !known[1]) out[known[0]][k] = -out[!known[0]][k];
    }
    return 1;
}

/* Computes the second difference that corrects interpolation along an edge: the value at its ends that is nearer to 0,
   or 0 if their signs differ, as they do at a kink. */
static void sbl__edge_parabola(const sbl__refine *r, const sbl__edge *e, int layer, float out[3]) {
    float at[2][3];
    int k;
    sbl__edge_curvature(r, e, layer, at);
    for (k = 0; k < 3; k++) {
        const float a = at[0][k], b = at[1][k];
        out[k] = a * b <= 0 ? 0 : sbl__abs(a) < sbl__abs(b) ? a : b;
    }
}

/* >>refine: the error of interpolation */

/* Returns the root mean square error of interpolation along an edge in one channel. at_0, at_1: second differences
   at its ends; d: difference between its ends. Around a step of light, at_0 and at_1 are as large as d, with opposite
   signs. In the middle of a wide penumbra they are smaller than d, and the error is small. */
static float sbl__edge_error(float at_0, float at_1, float d) {
    const float a = sbl__abs(at_0), b = sbl__abs(at_1);
    const float most = SBL__MAX(a, b), least = SBL__MIN(a, b);
    const float abrupt = SBL__MIN(0.5f * (a + b) / SBL__MAX(sbl__abs(d), 1e-30f), 1.0f);
    const float even = at_0 * at_1 < 0 ? SBL__STEP_ERROR * 0.5f * (a + b) * abrupt : SBL__CURVE_ERROR * least;
    return even + SBL__CURVE_ERROR * (most - least) * abrupt;
}

/* Returns the relative squared error for a variance of luminance. */
static float sbl__relative2(const sbl__refine *r, double variance) {
    return (float)SBL__MIN(variance / r->luminance / r->luminance, 1e30);
}

/* Returns the relative squared error for a difference of two radiances. */
static float sbl__squared(const sbl__refine *r, const float difference[3]) {
    float sum = 0;
    int k;
    for (k = 0; k < 3; k++) sum += r->weights[k] * difference[k] * (r->weights[k] * difference[k]);
    return SBL__MIN(sum, 1e30f);  /* The bound keeps the result finite and removes a NaN. */
}

static float sbl__distance2(const float a[3], const float b[3]) {
    const float d[3] = { a[0] - b[0], a[1] - b[1], a[2] - b[2] };
    return sbl__dot(d, d);
}

/* Returns the squared error of extrapolation from an end of an edge into the tile, estimated from the second difference
   beyond that end. Adds to *unseen2 the part for changes of light between the sensor and the border of its surface. */
static float sbl__extrapolation_bias2(const sbl__refine *r, const sbl__edge *e, int end, float *unseen2) {
    const sbl__pixel *p = e->ends[end], *other = e->ends[!end];
    const sbl__pixel *next = sbl__sensor_beyond(r, p, e, end, 1), *last = sbl__sensor_beyond(r, p, e, end, 2);
    float difference[3], unseen[3], share = SBL__SILHOUETTE_ERROR;
    int k;
    if (other->id && (!next || sbl__distance2(p->position, other->position) < SBL__CONTACT_DISTANCE *
                                   SBL__CONTACT_DISTANCE * sbl__distance2(p->position, next->position)))
        share = SBL__CONTACT_ERROR;
    for (k = 0; k < 3; k++) {
        const double known = next && last ? p->radiance[k] - 2 * next->radiance[k] + last->radiance[k]
                           : next         ? p->radiance[k] - next->radiance[k] : 0;
        unseen[k] = share * SBL__MAX(p->radiance[k], r->mean[k]);
        difference[k] = SBL__MAX(SBL__EXTRAPOLATION_ERROR * (float)fabs(known), unseen[k]);
    }
    *unseen2 += sbl__squared(r, unseen);
    return sbl__squared(r, difference);
}

/* Estimates the squared error of a tile's pixels from differences of light along its edges: those of interpolation,
   and those of extrapolation to pixels that no corner covers. Sets c->unseen_bias2, a part of the latter. */
static float sbl__tile_edge_bias2(const sbl__refine *r, sbl__tile *c) {
    float inside = 0, outside = 0, unseen = 0;
    int side, end, k, insides = 0, outsides = 0;
    for (side = 0; side < 4; side++) {
        const sbl__edge e = sbl__tile_edge(r, c, side);
        float at[2][3], error[3];
        if (e.ends[0] == e.ends[1]) continue;
        if (sbl__edge_curvature(r, &e, 0, at)) {
            for (k = 0; k < 3; k++)
                error[k] = sbl__edge_error(at[0][k], at[1][k], e.ends[1]->radiance[k] - e.ends[0]->radiance[k]);
            inside += sbl__squared(r, error);
            insides++;
        } else for (end = 0; end < 2; end++)
            if (sbl__usable(e.ends[end])) {
                outside += sbl__extrapolation_bias2(r, &e, end, &unseen);
                outsides++;
            }
    }
    if (insides) inside /= (float)insides;
    outside = outsides ? outside / (float)outsides : inside;
    c->unseen_bias2 = outsides ? c->uncovered * unseen / (float)outsides : 0;
    return (1 - c->uncovered) * inside + c->uncovered * outside;
}

/* Returns the next sensor that splits of neighbours put on a tile's edges, or NULL. Skips corners, where interpolation
   is exact. *at: counts pixels of the edges, from 0. *guess: receives the light that the tile interpolates there. */
static const sbl__pixel *sbl__tile_next_sensor(const sbl__refine *r, const sbl__tile *c, int *at, sbl__mix *guess) {
    const sbl__range *a = &c->area;
    const int width = a->x[1] - a->x[0], height = a->y[1] - a->y[0];
    while (*at < 2 * (width + height)) {
        const int along = *at < 2 * width, i = along ? *at >> 1 : (*at - 2 * width) >> 1, far_side = *at & 1;
        const int x = along ? a->x[0] + i : a->x[far_side], y = along ? a->y[far_side] : a->y[0] + i;
        const sbl__pixel *p = sbl__pixel_at(r, x, y);
        (*at)++;
        if (i == 0 || !sbl__usable(p)) continue;
        sbl__interpolate(r, c, x, y, 0, guess);
        return p;
    }
    return NULL;
}

/* Returns the squared error of interpolation measured at the sensors on a tile's edges. */
static float sbl__tile_sensor_bias2(const sbl__refine *r, const sbl__tile *c) {
    const sbl__pixel *p;
    sbl__mix guess;
    float sum = 0, difference[3];
    int k, at = 0, count = 0;
    while ((p = sbl__tile_next_sensor(r, c, &at, &guess)) != NULL) {
        if (!(guess.covered > 0)) continue;
        for (k = 0; k < 3; k++) difference[k] = p->radiance[k] - guess.light[k];
        sum += SBL__MAX(sbl__squared(r, difference) -
                        1.5f * sbl__relative2(r, guess.variance + sbl__variance(r, p)), 0.0f);
        count++;
    }
    return count ? sum / (float)count : 0;
}

/* Returns the squared error of interpolation in a tile, noise included. The error at sensors on the edges counts only
   half, because they are where neighbours had reason to split. */
static float sbl__tile_raw_bias2(const sbl__refine *r, sbl__tile *c) {
    const float edges2 = sbl__tile_edge_bias2(r, c), sensors2 = sbl__tile_sensor_bias2(r, c);
    return SBL__MAX(edges2, 0.5f * (edges2 + sensors2));
}

/* >>refine: tiles */

/* Summary of the sensors at a tile's corners. */
typedef struct sbl__corners {
    int looks;                /* fewest looks of any usable sensor; 0: no corner has one */
    int is_new;               /* 1: the last round has read at least one of the sensors */
    int unread;               /* 1: at least one of the sensors has not been read yet */
} sbl__corners;

static sbl__corners sbl__tile_corners(const sbl__refine *r, const sbl__tile *c) {
    sbl__corners all = { 0, 0, 0 };
    int corner;
    for (corner = 0; corner < 4; corner++) {
        const sbl__pixel *p = sbl__tile_corner(r, c, corner);
        if (sbl__usable(p) && p->looks) all.looks = all.looks ? SBL__MIN(all.looks, p->looks) : p->looks;
        all.is_new |= p->round == r->rounds - 1;
        all.unread |= p->id && !p->sensed;
    }
    return all;
}

/* Adds a tile. parent: index of the tile that is split, or -1. New sensors begin with as many looks as the sensors of
   the parent, because with fewer looks they would be noisier than interpolation. */
static sbl_result sbl__refine_add_tile(sbl__refine *r, const sbl__range *area, int parent) {
    sbl__tile *c;
    if (!sbl__grow(&r->core->base, &r->tiles, &r->tile_room, r->tile_count + 1, sizeof *r->tiles))
        return SBL_ERROR_OUT_OF_MEMORY;
    c = &r->tiles[r->tile_count++];
    memset(c, 0, sizeof *c);
    c->area = *area;
    c->level = parent < 0 ? 0 : r->tiles[parent].level + 1;
    c->parent = parent;
    c->looks = parent < 0 ? 1 : SBL__MAX(1, sbl__tile_corners(r, &r->tiles[parent]).looks);
    return SBL_SUCCESS;
}

/* Divides a tile into up to four. A tile less than 2 pixels wide is not divided in width; height likewise. */
static sbl_result sbl__tile_split(sbl__refine *r, int index) {
    const sbl__range a = r->tiles[index].area;
    const int xs[3] = { a.x[0], (a.x[0] + a.x[1]) / 2, a.x[1] }, ys[3] = { a.y[0], (a.y[0] + a.y[1]) / 2, a.y[1] };
    sbl_result result = SBL_SUCCESS;
    int i;
    r->tiles[index].split = 1;
    for (i = 0; i < 4 && result == SBL_SUCCESS; i++) {
        const int column = i & 1, row = i >> 1;
        const sbl__range part = { { xs[column], xs[column + 1] }, { ys[row], ys[row + 1] } };
        if ((column || xs[0] < xs[1]) && (row || ys[0] < ys[1])) result = sbl__refine_add_tile(r, &part, index);
    }
    return result;
}

/* Returns the largest absolute difference in any channel of two radiances. *sum: the largest a + b of any channel. */
static float sbl__difference(const float a[3], const float b[3], float *sum) {
    float most = 0;
    int k;
    *sum = 0;
    for (k = 0; k < 3; k++) {
        most = SBL__MAX(most, (float)fabs((double)a[k] - b[k]));
        *sum = SBL__MAX(*sum, a[k] + b[k]);
    }
    return most;
}

/* Returns 1 if two radiances differ by more than the threshold and by more than noise of this variance explains. */
static int sbl__differ(const sbl__refine *r, const float a[3], const float b[3], double variance) {
    float sum, least;
    const float most = sbl__difference(a, b, &sum);
    least = r->threshold * (r->geometry_aware ? 0.5f * sum + SBL__DIFFERENCE_FLOOR * r->luminance : 1.0f);
    return (double)most * most > (double)least * least + SBL__NOISE_WEIGHT * variance;
}

/* Returns 1 if the light of two corners on one surface differs (see sbl__differ), or if the light of a sensor
   on an edge of the tile differs from the interpolated light. */
static int sbl__tile_differs(const sbl__refine *r, const sbl__tile *c) {
    const sbl__pixel *p;
    sbl__mix guess;
    int i, k, at = 0;
    for (i = 0; i < 4; i++)
        for (k = i + 1; k < 4; k++) {
            const sbl__pixel *a = sbl__tile_corner(r, c, i), *b = sbl__tile_corner(r, c, k);
            if (sbl__connected(a, b, r->geometry_aware) &&
                sbl__differ(r, a->radiance, b->radiance, sbl__variance(r, a) + sbl__variance(r, b))) return 1;
        }
    while ((p = sbl__tile_next_sensor(r, c, &at, &guess)) != NULL)
        if (guess.own > 0 && sbl__differ(r, guess.light, p->radiance, guess.variance + sbl__variance(r, p))) return 1;
    return 0;
}

/* Adds row y of pixels to c->pixels and c->uncovered. Sets c->must_split if corners give one too little weight. */
static void sbl__tile_count(const sbl__refine *r, sbl__tile *c, const sbl__range *pixels, int y) {
    const int extrapolated = r->geometry_aware && sbl__tile_span(c) <= SBL__EXTRAPOLATED_SPAN && !(r->threshold > 0);
    int x;
    for (x = pixels->x[0]; x <= pixels->x[1]; x++) {
        const sbl__pixel *p = sbl__pixel_at(r, x, y);
        sbl__mix m;
        if (!p->id) continue;
        c->pixels++;
        if (p->sensed) continue;
        sbl__interpolate(r, c, x, y, 0, &m);
        c->uncovered += 1 - m.own;
        c->must_split |= (extrapolated ? m.covered : m.own) < SBL__COVERAGE;
    }
}

/* >>refine: guides for sensors' rays, see >>guide */

/* Returns the pixel where a guide stands, or NULL. */
static const sbl__pixel *sbl__guide_pixel(const sbl__refine *r, int column, int row) {
    const sbl__pixel *p = sbl__pixel_inside(r, column * r->guides.step, row * r->guides.step);
    return p && p->id ? p : NULL;
}

/* Returns how well a guide made at pixel a suits pixel b: sbl__belongs, or 0 if the tangents at the two pixels, from
   which guides count angles, point in different directions. */
static float sbl__guide_fits(const sbl__pixel *a, const sbl__pixel *b) {
    const float belongs = sbl__belongs(a, b, 1);
    double right[2][3], up[3];
    if (!(belongs > 0) || a == b) return belongs;
    sbl__frame(a->normal, 0, right[0], up);
    sbl__frame(b->normal, 0, right[1], up);
    return right[0][0] * right[1][0] + right[0][1] * right[1][1] + right[0][2] * right[1][2] > 0.9 ? belongs : 0;
}

/* Returns the number of the guide, among the four around a pixel, whose site is most like the pixel in position and
   normal; 0: none belongs to the pixel's surface. */
static int sbl__guide_for(const sbl__refine *r, int index) {
    const sbl__guides *g = &r->guides;
    const int x = index % r->width, y = index / r->width;
    float most = 0;
    int corner, best = 0;
    for (corner = 0; r->spec->guided && corner < 4; corner++) {
        const int column = x / g->step + (corner & 1), row = y / g->step + (corner >> 1);
        const sbl__pixel *p = sbl__guide_pixel(r, column, row);
        const float dx = (float)abs(column * g->step - x) / (float)g->step;
        const float dy = (float)abs(row * g->step - y) / (float)g->step;
        const float fits = p ? sbl__guide_fits(&r->pixels[index], p) * (1.01f - dx) * (1.01f - dy) : 0;
        if (fits > most) { most = fits; best = 1 + row * g->columns + column; }
    }
    return best;
}

/* >>refine: rounds, from the sites that are wanted to the readings that are taken */

/* Adds the first-level tiles, which cover the whole picture, row by row. */
static sbl_result sbl__refine_tiles(void *work, sbl__slice *slice) {
    sbl__refine *r = (sbl__refine *)work;
    int *y = &r->stages.at, x;
    for (; *y == 0 || *y < r->height - 1; *y += r->tile_size) {
        if (sbl__late(slice)) return SBL_UNFINISHED;
        for (x = 0; x == 0 || x < r->width - 1; x += r->tile_size) {
            const sbl__range area = { { x, SBL__MIN(x + r->tile_size, r->width - 1) },
                                      { *y, SBL__MIN(*y + r->tile_size, r->height - 1) } };
            if (sbl__refine_add_tile(r, &area, -1) != SBL_SUCCESS) return SBL_ERROR_OUT_OF_MEMORY;
        }
    }
    return SBL_SUCCESS;
}

/* Makes the site of pixel number `index` for looks from number `first` on. */
static void sbl__refine_site(const sbl__refine *r, int index, int first, int looks, sbl__site *out) {
    const sbl__pixel *p = &r->pixels[index];
    memcpy(out->position, p->position, sizeof out->position);
    memcpy(out->normal, p->normal, sizeof out->normal);
    memcpy(out->geometric_normal, p->geometric_normal, sizeof out->geometric_normal);
    out->offset = p->offset;
    out->number = (uint32_t)index;
    out->guide = sbl__guide_for(r, index);
    out->first = first;
    out->looks = looks;
}

/* Makes room for `more` additional sites and their readings. */
static int sbl__refine_room(sbl__refine *r, int more) {
    const int count = r->site_count + more;
    sbl__base *base = &r->core->base;
    return sbl__grow(base, &r->sites, &r->site_room, count, sizeof *r->sites) &&
           sbl__grow(base, &r->readings, &r->reading_room, count, sizeof *r->readings) &&
           sbl__grow(base, &r->reading_layers, &r->reading_layer_room, count, r->harmonics * sizeof(float));
}

/* Lists sites for those corners of the next tiles that need a sensor or more looks, until they fill a job. */
static sbl_result sbl__refine_list(void *work, sbl__slice *slice) {
    sbl__refine *r = (sbl__refine *)work;
    int corner;
    for (; r->listed < r->tile_count && r->look_count < SBL__JOB_LOOKS; r->listed++) {
        const sbl__tile *c = &r->tiles[r->listed];
        if (sbl__late(slice)) return SBL_UNFINISHED;
        if (c->split) continue;
        if (!sbl__refine_room(r, 4)) return SBL_ERROR_OUT_OF_MEMORY;
        for (corner = 0; corner < 4; corner++) {
            sbl__pixel *p = sbl__tile_corner(r, c, corner);
            if (!p->id || p->queued || (p->sensed && p->wanted <= p->looks)) continue;
            p->queued = 1;
            if (!p->sensed) {
                p->level = (unsigned char)(1 + SBL__MIN(c->level, SBL_MAX_LEVELS - 1));
                p->look = r->look_count;
                p->wanted = c->looks;
            }
            sbl__refine_site(r, (int)(p - r->pixels), p->looks, p->wanted - p->looks, &r->sites[r->site_count++]);
            r->look_count += p->wanted - p->looks;
        }
    }
    return SBL_SUCCESS;
}

/* Returns the occlusion of a texel of a lightmap. No viewer sees a hidden texel: surfaces lie on it, in most directions
   nearer than the size of a texel, or it is inside a solid, which no bounce reaches. A touched texel is close to the
   edge of a surface that hides texels, where light changes within a fraction of a texel. */
static int sbl__refine_occlusion(sbl__refine *r, const sbl_reading *reading) {
    const int dark = sbl__all_zero(reading->radiance, 3), backs = reading->back_share > 0.5f;
    if (!(r->distance_limit > 0) || !(reading->hit_min > 0)) return 0;
    r->lit += !dark;
    r->lit_backs += dark ? 0 : (double)reading->back_share;
    if (r->spec->bounced && dark && backs && r->lit_backs <= 0.5 * r->lit) return SBL__HIDDEN;
    if (reading->hit_share > SBL__HIDDEN_SHARE && reading->hit_mean < SBL__HIDDEN_NEAR * r->distance_limit)
        return SBL__HIDDEN;
    return reading->hit_min < SBL__HIDDEN_TOUCH * r->distance_limit ? SBL__TOUCHED : 0;
}

/* Decides from the first reading of a pixel whether its light may be shown. Hidden texels and touched texels next to
   them take their neighbours' light, because their own would show beyond the edge of the object that hides them. */
static void sbl__refine_validate(sbl__refine *r, int index, const sbl_reading *reading) {
    sbl__pixel *p = &r->pixels[index];
    int i;
    p->invalid = !reading->valid;
    p->occlusion = (unsigned char)sbl__refine_occlusion(r, reading);
    if (p->occlusion == SBL__HIDDEN) {
        p->invalid = 1;
        r->uncertainty2 -= (double)p->uncertainty * p->uncertainty;  /* A hidden texel shows its neighbours' light. */
        p->uncertainty = 0;
    }
    for (i = 0; i < 9 && p->occlusion; i++) {
        sbl__pixel *other = sbl__pixel_inside(r, index % r->width + i % 3 - 1, index / r->width + i / 3 - 1);
        if (!other || other->id != p->id) continue;
        if (p->occlusion == SBL__TOUCHED && other->occlusion == SBL__HIDDEN) p->invalid = 1;
        if (p->occlusion == SBL__HIDDEN && other->occlusion == SBL__TOUCHED) other->invalid = 1;
    }
}

/* Computes layers 1 and up, which are harmonics, for light that comes evenly from a pixel's whole hemisphere. */
static void sbl__refine_even(const sbl__refine *r, const sbl__pixel *p, float *out) {
    static const int axes[3] = { 1, 2, 0 };
    size_t i;
    for (i = 0; i < r->harmonics; i++)
        out[i] = (float)SBL__PI * p->radiance[i % 3] *
                 (i < 3 ? 2 * SBL__HARMONIC_0 : SBL__HARMONIC_1 * p->normal[axes[i / 3 - 1]]);
}

static int sbl__refine_sites(void *work) { return ((sbl__refine *)work)->site_count; }

/* Adds the reading of a site to the means of its pixel. */
static sbl_result sbl__refine_take(void *work, int at) {
    sbl__refine *r = (sbl__refine *)work;
    const sbl_reading *reading = &r->readings[at];
    const int looks = r->sites[at].looks;
    sbl__pixel *p = &r->pixels[r->sites[at].number];
    sbl_stats *stats = &r->core->stats;
    const float share = (float)looks / (float)(p->looks + looks);
    const double off = (double)sbl__luminance(reading->radiance) - sbl__luminance(p->radiance);
    float *light = r->layers + r->harmonics * r->sites[at].number;
    const float *found = r->reading_layers + r->harmonics * (size_t)at;
    size_t i;
    for (i = 0; i < 3; i++) p->radiance[i] += share * (reading->radiance[i] - p->radiance[i]);
    for (i = 0; i < r->harmonics; i++) light[i] += share * (found[i] - light[i]);
    p->variance += (double)share * ((double)reading->noise * reading->noise * looks - p->variance);
    if (p->looks) sbl__looks_compare(r, p, p->looks, looks, off * off);
    p->looks += looks;
    r->looks_taken += looks;
    p->queued = 0;
    p->round = (short)r->rounds;
    for (i = 0; i < 3 && r->rounds == 0; i++) r->sum[i] += p->radiance[i];
    r->pixels_summed += r->rounds == 0;
    if (p->sensed) return SBL_SUCCESS;
    p->sensed = 1;
    sbl__refine_validate(r, (int)r->sites[at].number, reading);
    stats->sensors.invalid += p->invalid;
    stats->picture.levels[p->level - 1].sensors++;
    stats->picture.level_count = SBL__MAX(stats->picture.level_count, p->level);
    stats->sensors.count++;
    return SBL_SUCCESS;
}

/* Makes r->spec anew after a change of r->measurement, but keeps its `directional` and `guided` flags. */
static void sbl__refine_update_spec(sbl__refine *r) {
    const int directional = r->spec->directional, guided = r->spec->guided;
    sbl__spec_make(r->spec, r->measurement, &r->core->scene, &r->core->desc);
    r->spec->directional = directional;
    r->spec->guided = guided;
}

/* Makes all sensors of the first round, which are at the corners of first-level tiles, take their looks again. */
static void sbl__refine_restart(sbl__refine *r) {
    int i, corner;
    for (i = 0; i < r->tile_count; i++)
        for (corner = 0; corner < 4; corner++) {
            sbl__pixel *p = sbl__tile_corner(r, &r->tiles[i], corner);
            p->looks = 0;
            p->wanted = 1;
        }
    r->rounds = r->first_new = r->weighed = 0;
    memset(r->sum, 0, sizeof r->sum);
    r->pixels_summed = 0;
}

/* >>refine: scouts, single rays from which guides are made */

/* Returns a seed that differs from the sensors' seed, so that scouts and sensors send independent rays. */
static uint32_t sbl__scouts_seed(const sbl__refine *r) { return sbl__hash(r->spec->seed ^ 0x9e3779b9u); }

/* Chooses the places of guides and allocates memory for them. */
static sbl_result sbl__guides_begin(sbl__refine *r) {
    sbl__guides *g = &r->guides;
    sbl__base *base = &r->core->base;
    size_t rows;
    for (g->step = SBL__GUIDE_STEP / 4; ; g->step *= 2) {
        g->columns = (r->width - 1) / g->step + 1;
        g->rows = (r->height - 1) / g->step + 1;
        if (g->columns * (double)g->rows < (g->step < SBL__GUIDE_STEP ? SBL__GUIDES_FEW : SBL__GUIDES_MOST)) break;
    }
    rows = (size_t)sbl__guide_rows(g);
    g->found = (float *)sbl__alloc(base, (size_t)g->columns * (size_t)g->rows * SBL__GUIDE_BINS, sizeof *g->found);
    g->words = (uint32_t *)sbl__alloc(base, rows * SBL__GUIDES_ACROSS * SBL__GUIDE_WORDS, sizeof *g->words);
    return g->found && g->words ? SBL_SUCCESS : SBL_ERROR_OUT_OF_MEMORY;
}

/* Lists the sites of the scouts of the next guides, which are all at the guide's place, until they fill a job. */
static sbl_result sbl__scouts_list(void *work, sbl__slice *slice) {
    sbl__refine *r = (sbl__refine *)work;
    const sbl__guides *g = &r->guides;
    int i;
    if (!g->words && sbl__guides_begin(r) != SBL_SUCCESS) return SBL_ERROR_OUT_OF_MEMORY;
    for (; r->listed < g->columns * g->rows && r->site_count < SBL__SCOUTS_AT_ONCE; r->listed++) {
        const int column = r->listed % g->columns, row = r->listed / g->columns;
        if (sbl__late(slice)) return SBL_UNFINISHED;
        if (!sbl__guide_pixel(r, column, row)) continue;
        if (!sbl__refine_room(r, SBL__SCOUTS)) return SBL_ERROR_OUT_OF_MEMORY;
        for (i = 0; i < SBL__SCOUTS; i++)
            sbl__refine_site(r, (row * r->width + column) * g->step, i, 1, &r->sites[r->site_count++]);
    }
    return SBL_SUCCESS;
}

/* Adds the squared luminance that each scout found to the bins of its guide. */
static sbl_result sbl__scouts_take(void *work, sbl__slice *slice) {
    sbl__refine *r = (sbl__refine *)work;
    const sbl__guides *g = &r->guides;
    uint32_t *sequence = sbl__sequence_make(&r->core->base, SBL__SCOUTS, 1, 1);
    int *at = &r->stages.at;
    if (!sequence) return SBL_ERROR_OUT_OF_MEMORY;
    for (; *at < r->site_count && !sbl__late(slice); ++*at) {
        const sbl__site *site = &r->sites[*at];
        const int column = (int)site->number % r->width / g->step, row = (int)site->number / r->width / g->step;
        const float light = r->readings[*at].valid ? sbl__luminance(r->readings[*at].radiance) : 0;
        double u[2];
        sbl__sequence_at(sequence, site->first, sbl__sensor_seed(site->number, sbl__scouts_seed(r)), u);
        sbl__guide_found(g, row * g->columns + column)[sbl__guide_bin(u[0], u[1])] += light * light;
    }
    sbl__free(&r->core->base, sequence);
    return *at < r->site_count ? SBL_UNFINISHED : SBL_SUCCESS;
}

/* Makes guide number `guide` from what the scouts around it found; guide 0 sends rays evenly. */
static void sbl__guides_make(const sbl__refine *r, int guide) {
    static const float weights[5] = { 0.3f, 0.7f, 1, 0.7f, 0.3f };
    const sbl__guides *g = &r->guides;
    const int place = SBL__MAX(guide - 1, 0), column = place % g->columns, row = place / g->columns;
    const sbl__pixel *own = guide ? sbl__guide_pixel(r, column, row) : NULL;
    float found[SBL__GUIDE_BINS];
    int i, k, n;
    memset(found, 0, sizeof found);
    for (i = -2; i <= 2 && own; i++)
        for (k = -2; k <= 2; k++) {
            const sbl__pixel *p = sbl__guide_pixel(r, column + k, row + i);
            const float fits = p ? weights[i + 2] * weights[k + 2] * sbl__guide_fits(own, p) : 0;
            const float *from = p ? sbl__guide_found(g, place + i * g->columns + k) : NULL;
            for (n = 0; n < SBL__GUIDE_BINS && fits > 0; n++) found[n] += fits * from[n];
        }
    sbl__guide_make(found, sbl__guide_words(g, guide));
}

/* Makes all guides and sends them to the GPU. */
static sbl_result sbl__guides_send(void *work, sbl__slice *slice) {
    sbl__refine *r = (sbl__refine *)work;
    sbl__guides *g = &r->guides;
    sbl__device *d = &r->core->device;
    const int rows = sbl__guide_rows(g);
    int *at = &r->stages.at;
    sbl_result result;
    for (; *at <= g->columns * g->rows; ++*at) {
        if (sbl__late(slice)) return SBL_UNFINISHED;
        sbl__guides_make(r, *at);
    }
    d->gl.doing = "sending guides";
    result = sbl__texture_make(d, &g->texture, SBL__GUIDES_ACROSS * SBL__GUIDE_TEXELS, rows, SBL__GL_RGBA32UI);
    if (result == SBL_SUCCESS) result = sbl__texture_write(d, &g->texture, 0, rows, g->words);
    if (result != SBL_SUCCESS) return result;
    sbl__free(&r->core->base, g->found);
    g->found = NULL;
    return SBL_SUCCESS;
}

/* >>refine: weighing gain against cost */

static int sbl__worth_bin(float worth) {
    int exponent;
    const double mantissa = frexp((double)worth, &exponent);
    const int bin = 4 * (exponent + 100) + (int)(8 * (mantissa - 0.5));
    return SBL__MIN(SBL__MAX(bin, 0), SBL__GAIN_BINS - 1);
}

/* Returns the least worth that falls into a bin. */
static float sbl__bin_worth(int bin) { return (float)ldexp(0.5 + 0.125 * (bin % 4), bin / 4 - 100); }

/* Adds to the histograms what removes the squared error `gain` for each look that it costs. */
static void sbl__weigh_add(sbl__refine *r, float worth, float gain, int cost) {
    const int bin = sbl__worth_bin(worth);
    r->gains[bin] += (double)gain * cost;
    r->costs[bin] += cost;
}

/* Prepares for weighing all tiles. Errors are relative to the mean R that the previous round summed up. */
static void sbl__weigh_begin(sbl__refine *r) {
    int k;
    sbl__looks_calibrate(r);
    for (k = 0; k < 3 && r->pixels_summed > 0; k++) r->mean[k] = (float)(r->sum[k] / r->pixels_summed);
    r->luminance = SBL__MAX(sbl__luminance(r->mean), 1e-30f);
    for (k = 0; k < 3; k++)
        r->weights[k] = (float)sqrt((double)sbl__luminance_weights[k] / r->luminance /
                                    (double)SBL__MAX(r->mean[k], 0.01f * r->luminance));
    memset(r->sum, 0, sizeof r->sum);
    memset(r->gains, 0, sizeof r->gains);
    memset(r->costs, 0, sizeof r->costs);
    r->pixels_summed = r->bias2 = r->noise2 = r->look_variance = 0;
    r->bought = 0;
}

/* Returns how many pixels the filter averages in a tile of span 1: fewer where neighbours differ visibly. */
static float sbl__tile_smoothing(const sbl__refine *r, const sbl__tile *c, float noise) {
    float alike = 0;
    int side, count = 0;
    for (side = 0; side < 4; side++) {
        const sbl__edge e = sbl__tile_edge(r, c, side);
        const sbl__pixel *a = e.ends[0], *b = e.ends[1];
        if (a == b || !sbl__usable(a) || !sbl__usable(b)) continue;
        count++;
        if (sbl__belongs(a, b, r->geometry_aware) > 0) {
            float sum, d = sbl__difference(a->radiance, b->radiance, &sum);
            d /= SBL__MAX(2 * noise + SBL__FILTER_VISIBLE * sum, SBL__DIVISOR_LEAST);
            alike += (float)exp(-SBL__FILTER_FALL * d * d);
        }
    }
    if (count) alike /= (float)count;
    return 1 + 0.5f * (r->smoothing - 1) * alike * alike;
}

/* Computes a tile's noise from its corners, and adds the tile's light to r->sum. */
static void sbl__tile_noise(sbl__refine *r, sbl__tile *c) {
    const int span = sbl__tile_span(c);
    float variance, share = 0, light[3] = { 0, 0, 0 };
    double sum = 0;
    int corner, k, count = 0;
    for (corner = 0; corner < 4; corner++) {
        const sbl__pixel *p = sbl__tile_corner(r, c, corner);
        if (!sbl__usable(p)) continue;
        sum += p->variance;
        share += sbl__variance_share(r, p->looks);
        for (k = 0; k < 3; k++) light[k] += p->radiance[k];
        count++;
    }
    c->noise2 = 0;
    if (!count) return;
    c->variance = variance = sbl__relative2(r, sum / count);
    if (c->parent >= 0) c->variance += SBL__PARENT_WEIGHT * (r->tiles[c->parent].variance - variance);
    variance = c->variance * share / (float)count;
    c->noise2 = span > 1 ? variance * sbl__noise_left(r, span)
                         : variance / sbl__tile_smoothing(r, c, r->luminance * (float)sqrt((double)variance));
    for (k = 0; k < 3; k++) r->sum[k] += (double)light[k] * c->pixels / count;
    r->pixels_summed += c->pixels;
    r->look_variance += (double)c->variance * c->pixels;
    c->light = sbl__luminance(light) / (float)count;
}

/* Updates c->raw_bias2 or, if c->must_split or a threshold decides, c->split_worth (FLT_MAX: split; 0: do not). */
static void sbl__tile_weigh_split(const sbl__refine *r, sbl__tile *c) {
    const int span = sbl__tile_span(c);
    if (span <= 1) return;
    if (c->must_split) c->split_worth = FLT_MAX;
    else if (r->threshold > 0) c->split_worth = sbl__tile_differs(r, c) ? FLT_MAX : 0;
    else if (c - r->tiles >= r->first_new || sbl__tile_corners(r, c).is_new || span > SBL__EXTRAPOLATED_SPAN)
        c->raw_bias2 = sbl__tile_raw_bias2(r, c);
}

/* Predicts the errors of a tile, and the gain of each way to reduce them: a split, or more looks. The gain is the
   reduction of the sum of squared errors per look. Adds the gains to the histogram from which sbl__weigh_end finds
   the least worth that is bought. */
static sbl_result sbl__refine_weigh(void *work, int at) {
    sbl__refine *r = (sbl__refine *)work;
    sbl__tile *c = &r->tiles[at];
    float bias2, gain, variance, weight;
    int looks = sbl__tile_corners(r, c).looks, most, interpolated;
    if (c->split) return SBL_SUCCESS;
    sbl__tile_weigh_split(r, c);
    sbl__tile_noise(r, c);
    interpolated = SBL__MAX(c->pixels - 1, 0);  /* all but the upper left pixel, which has a sensor */
    variance = c->noise2 / sbl__noise_left(r, sbl__tile_span(c));
    c->bias2 = SBL__MAX(c->raw_bias2 - SBL__NOISE_IN_BIAS * variance, c->unseen_bias2);
    r->bias2 += (double)c->bias2 * interpolated;
    r->noise2 += (double)c->noise2 * c->pixels;
    bias2 = SBL__MAX(c->raw_bias2 - SBL__NOISE_IN_SPLITS * variance, c->unseen_bias2);
    weight = 1 / (c->light / r->luminance + SBL__GAIN_FLOOR);
    if (sbl__tile_span(c) > 1 && !(r->threshold > 0)) {
        const float error_max = SBL__TILE_ERROR_MAX * r->target_error *
                                (c->light / r->luminance + SBL__TILE_ERROR_FLOOR);
        const int cost = SBL__SPLIT_COST * SBL__MAX(looks, 1);
        gain = bias2 * SBL__SPLIT_GAIN * (float)interpolated / (float)cost;
        if (c->split_worth < FLT_MAX) c->split_worth = bias2 > error_max * error_max ? FLT_MAX : gain * weight;
        if (gain > 0) sbl__weigh_add(r, c->split_worth, gain, cost);
    }
    c->look_worth = 0;
    if (!looks || looks >= r->spec->looks) return SBL_SUCCESS;
    gain = c->noise2 * (float)c->pixels * (1 - SBL__LOOKS_GAIN) / (float)looks;
    c->look_worth = gain * weight;
    most = SBL__MIN(SBL__LOOKS_GROWTH * looks, r->spec->looks);
    for (; looks < most; looks *= 2) {
        if (gain > 0) sbl__weigh_add(r, gain * weight, gain, looks);
        gain *= SBL__LOOKS_GAIN_NEXT;
    }
    return SBL_SUCCESS;
}

/* Foresees how many looks will have been taken when the squared error, which is `left` now, is at most target2. Where
   noise decides, as many looks are needed as bring the noise of each pixel to the target through the filter, if every
   pixel were alike; in fact wide tiles need fewer. The cost of all that is worth buying now is exact in the end, but
   too low until most tiles have been found that need sensors. */
static double sbl__weigh_expect(const sbl__refine *r, double left, double target2) {
    const double pixels = SBL__MAX(r->pixels_summed, 1.0), looks = SBL__MAX((double)r->looks_taken, 1.0);
    const double known = SBL__MIN(looks / (SBL__EXPECT_KNOWN * pixels), 1.0);
    double cost = looks, noise;
    int bin = SBL__GAIN_BINS;
    if (!(target2 > 0)) return 0;
    noise = SBL__EXPECT_SHARE * pixels * r->look_variance / (r->smoothing * target2);
    noise = SBL__MIN(SBL__MAX(noise, looks), SBL__MAX(r->spec->looks * pixels, looks));
    for (left -= target2 * pixels; bin > 0 && left > 0; left -= r->gains[bin]) cost += r->costs[--bin];
    return exp((1 - known) * log(noise) + known * log(cost));
}

/* Predicts the picture's error. Sets r->least_worth so that all splits and looks of at least this worth are predicted
   to bring it to the error at which the round aims, if they suffice. FLT_MAX, so that only necessary splits are
   bought: bias and noise are within their share of the target error, or SBL__MAX_ROUNDS have passed. */
static void sbl__weigh_end(sbl__refine *r) {
    const double pixels = SBL__MAX(r->pixels_summed, 1.0), all2 = (double)r->target_error * r->target_error;
    const double uncertainty2 = r->uncertainty2 / ((double)r->luminance * r->luminance * pixels);
    const double target2 = SBL__MAX(all2 - uncertainty2, SBL__AIM_LEAST * all2);
    double left = r->bias2 + r->noise2, aim;
    int bin = SBL__GAIN_BINS;
    r->look_variance /= pixels;
    r->predicted = sqrt(left / pixels + uncertainty2);
    r->stored = sqrt(uncertainty2);
    r->weighed = 1;
    r->expected_looks = sbl__weigh_expect(r, left, target2);
    r->least_worth = FLT_MAX;
    if (left <= target2 * pixels || r->rounds > SBL__MAX_ROUNDS) return;
    aim = SBL__MAX(SBL__AIM_BELOW * target2 * pixels, SBL__AIM_SHARE * left);
    while (bin > 1 && left > aim) left -= r->gains[--bin];
    r->least_worth = sbl__bin_worth(bin);
}

/* Sets `pixels`, `uncovered` and `must_split` of new tiles, row by row. */
static sbl_result sbl__refine_count(void *work, sbl__slice *slice) {
    sbl__refine *r = (sbl__refine *)work;
    int *at = &r->stages.at;
    for (*at = SBL__MAX(*at, r->first_new); *at < r->tile_count; ++*at, r->row = 0) {
        sbl__tile *c = &r->tiles[*at];
        const sbl__range pixels = sbl__tile_pixels(r, c);
        if (r->row == 0) c->pixels = c->must_split = 0;
        if (r->row == 0) c->uncovered = 0;
        for (; pixels.y[0] + r->row <= pixels.y[1]; r->row++) {
            if (sbl__late(slice)) return SBL_UNFINISHED;
            sbl__tile_count(r, c, &pixels, pixels.y[0] + r->row);
        }
        if (c->pixels) c->uncovered /= (float)c->pixels;
    }
    return SBL_SUCCESS;
}

static int sbl__refine_tile_count(void *work) { return ((sbl__refine *)work)->tile_count; }
static int sbl__refine_weighed(void *work) { return ((sbl__refine *)work)->first_new; }

/* Splits a tile, or gives its sensors as many more looks as are worth their cost. */
static sbl_result sbl__refine_spend(void *work, int at) {
    sbl__refine *r = (sbl__refine *)work;
    const sbl__tile *c = &r->tiles[at];
    float worth = c->look_worth;
    int corner, looks = sbl__tile_corners(r, c).looks, growth = 1;
    if (c->split) return SBL_SUCCESS;
    if (c->split_worth >= r->least_worth && sbl__tile_span(c) > 1) {
        r->bought++;
        return sbl__tile_split(r, at);
    }
    for (; growth < SBL__LOOKS_GROWTH && worth >= r->least_worth; growth *= 2) worth *= SBL__LOOKS_GAIN_NEXT;
    looks = SBL__MIN(looks * growth, r->spec->looks);
    for (corner = 0; corner < 4 && growth > 1; corner++) {
        sbl__pixel *p = sbl__tile_corner(r, c, corner);
        if (!sbl__usable(p) || !p->looks || p->wanted >= looks) continue;
        p->wanted = looks;
        r->bought++;
    }
    return SBL_SUCCESS;
}

/* >>refine: stages */

enum { SBL__REFINE_TILES, SBL__REFINE_COLLECT, SBL__REFINE_SENSE, SBL__REFINE_TAKE, SBL__REFINE_COUNT,
       SBL__REFINE_WEIGH, SBL__REFINE_SPEND, SBL__REFINE_RESTART, SBL__REFINE_COLLECT_SCOUTS, SBL__REFINE_SCOUT,
       SBL__REFINE_TAKE_SCOUTS, SBL__REFINE_GUIDES, SBL__REFINE_DONE };

static void sbl__refine_task(const sbl__refine *r, sbl__task *task) {
    memset(task, 0, sizeof *task);
    task->spec = *r->spec;
    task->guides = &r->guides;
}

/* Begins the job for the listed sites: looks, or scouts, which are looks of one ray over the hemisphere. */
static int sbl__refine_after_list(void *work) {
    sbl__refine *r = (sbl__refine *)work;
    const int scouts = r->stages.stage == SBL__REFINE_COLLECT_SCOUTS;
    sbl__task task;
    sbl__refine_task(r, &task);
    task.spec.distance_limit = r->distance_limit;
    if (scouts) {
        task.spec.rays = 1;
        task.spec.looks = SBL__SCOUTS;
        task.spec.lamp_rays = task.spec.directional = 0;
        task.spec.seed = sbl__scouts_seed(r);
    }
    task.sites = r->sites;
    task.readings = r->readings;
    task.layers = r->reading_layers;
    task.site_count = r->site_count;
    if (r->site_count) sbl__job_begin(&r->core->job, &r->core->scene, &task);
    return r->stages.stage + 1;
}

static sbl_result sbl__refine_sense(void *work, sbl__slice *slice) {
    const sbl__refine *r = (const sbl__refine *)work;
    return r->site_count ? sbl__core_sense(r->core, slice) : SBL_SUCCESS;
}

/* Begins another job if this round has tiles or guides whose sites no job has measured yet. */
static int sbl__refine_after_take(void *work) {
    sbl__refine *r = (sbl__refine *)work;
    const int scouts = r->stages.stage == SBL__REFINE_TAKE_SCOUTS;
    r->site_count = r->look_count = 0;
    if (r->listed < (scouts ? r->guides.columns * r->guides.rows : r->tile_count))
        return scouts ? SBL__REFINE_COLLECT_SCOUTS : SBL__REFINE_COLLECT;
    r->listed = 0;
    if (scouts) return SBL__REFINE_GUIDES;
    r->rounds++;
    sbl__weigh_begin(r);
    return SBL__REFINE_COUNT;
}

/* Returns 1 if looks prove to be good enough for the target error in the first round, otherwise the factor by which
   their rays must grow. */
static int sbl__refine_growth(const sbl__refine *r) {
    return r->rounds == 1 ? sbl__look_growth(r->measurement, r->target_error, r->look_variance) : 1;
}

static int sbl__refine_after_weigh(void *work) {
    sbl__refine *r = (sbl__refine *)work;
    sbl__weigh_end(r);
    if (sbl__refine_growth(r) > 1) return SBL__REFINE_RESTART;
    r->first_new = r->tile_count;
    r->core->stats.picture.expected_error = (float)r->predicted;
    r->core->stats.picture.stored_error = (float)r->stored;
    return SBL__REFINE_SPEND;
}

/* After a first round whose looks are too noisy, makes guides for their rays or, with guides or if spec->no_light is
   set, gives looks more rays. In both cases all sensors start again. */
static int sbl__refine_after_restart(void *work) {
    sbl__refine *r = (sbl__refine *)work;
    const int times = sbl__refine_growth(r);
    sbl__refine_restart(r);
    if (!r->spec->guided && !r->spec->no_light) return SBL__REFINE_COLLECT_SCOUTS;
    r->measurement->look_rays *= times;
    r->measurement->looks = SBL__MAX(r->measurement->looks / times, 1);
    sbl__refine_update_spec(r);
    return SBL__REFINE_COLLECT;
}

static int sbl__refine_after_spend(void *work) {
    const sbl__refine *r = (const sbl__refine *)work;
    return r->bought ? SBL__REFINE_COLLECT : SBL__REFINE_DONE;
}

static int sbl__refine_after_guides(void *work) {
    ((sbl__refine *)work)->spec->guided = 1;
    return SBL__REFINE_COLLECT;
}

/* Refines, piece by piece. Returns SBL_SUCCESS when the target error is reached or nothing is left to buy. */
static sbl_result sbl__refine_step(sbl__refine *r, sbl__slice *slice) {
    static const sbl__stage_row table[] = {
        { sbl__refine_tiles, NULL, NULL, NULL },
        { sbl__refine_list, sbl__refine_after_list, NULL, NULL },
        { sbl__refine_sense, NULL, NULL, NULL },
        { NULL, sbl__refine_after_take, sbl__refine_take, sbl__refine_sites },
        { sbl__refine_count, NULL, NULL, NULL },
        { NULL, sbl__refine_after_weigh, sbl__refine_weigh, sbl__refine_tile_count },
        { NULL, sbl__refine_after_spend, sbl__refine_spend, sbl__refine_weighed },
        { NULL, sbl__refine_after_restart, NULL, NULL },
        { sbl__scouts_list, sbl__refine_after_list, NULL, NULL },
        { sbl__refine_sense, NULL, NULL, NULL },
        { sbl__scouts_take, sbl__refine_after_take, NULL, NULL },
        { sbl__guides_send, sbl__refine_after_guides, NULL, NULL }
    };
    return sbl__stages_step(&r->stages, table, SBL__COUNT(table), r, slice);
}

/* >>refine: functions for later rooms */

/* smoothing: sbl__filter_pixels of the filter that is used later */
static void sbl__refine_begin(sbl__refine *r, sbl__core *c, sbl__measurement *measurement, sbl__spec *spec,
                              const sbl_picture_desc *desc, float smoothing) {
    r->core = c;
    r->measurement = measurement;
    r->spec = spec;
    r->width = desc->width;
    r->height = desc->height;
    r->tile_size = desc->tile;
    r->threshold = desc->threshold < 0 ? FLT_MIN : desc->threshold;
    r->target_error = desc->target_error;
    r->geometry_aware = desc->options.mode != SBL_MODE_PAPER;
    r->harmonics = 3 * (size_t)(sbl__spec_layers(spec) - 1);
    r->smoothing = smoothing;
    sbl__looks_calibrate(r);
}

static sbl_result sbl__refine_make(sbl__refine *r) {
    const size_t pixels = (size_t)r->width * (size_t)r->height;
    r->pixels = (sbl__pixel *)sbl__alloc_raw(&r->core->base, pixels, sizeof *r->pixels);
    r->layers = (float *)sbl__alloc(&r->core->base, pixels, r->harmonics * sizeof *r->layers);
    return r->pixels && r->layers ? SBL_SUCCESS : SBL_ERROR_OUT_OF_MEMORY;
}

/* Forgets all measurements, so that refinement can begin again. Each pixel keeps its values until sbl__refine_put
   replaces them. */
static void sbl__refine_forget(sbl__refine *r) {
    sbl__pixel *pixels = r->pixels;
    float *layers = r->layers;
    r->pixels = NULL;
    r->layers = NULL;
    sbl__refine_free(&r->core->device, r);
    r->pixels = pixels;
    r->layers = layers;
}

/* Sets a pixel before refinement begins. shown->sensed: 1: the pixel shows light of the store and needs no sensor */
static void sbl__refine_put(sbl__refine *r, size_t index, const sbl__pixel *shown) {
    float *light = r->layers + r->harmonics * index;
    r->pixels[index] = *shown;
    memset(light, 0, r->harmonics * sizeof *light);
    if (shown->sensed) sbl__refine_even(r, shown, light);
    r->uncertainty2 += (double)shown->uncertainty * shown->uncertainty;
}

/* Turns on the test for occlusion (see sbl__refine_occlusion). width: width of a texel, world units */
static void sbl__refine_hide_within(sbl__refine *r, float width) { r->distance_limit = SBL__HIDDEN_REACH * width; }

static const sbl__pixel *sbl__refine_pixel(const sbl__refine *r, size_t index) { return &r->pixels[index]; }

/* Returns the picture's predicted relative error; below 0: not known yet. */
static double sbl__refine_error(const sbl__refine *r) { return r->weighed ? r->predicted : -1; }

/* Returns the luminance of the picture's mean, to which errors are relative. */
static float sbl__refine_luminance(const sbl__refine *r) { return r->luminance; }

static int64_t sbl__refine_looks(const sbl__refine *r) { return r->looks_taken; }

static int sbl__refine_is_sensing(const sbl__refine *r) {
    return r->stages.stage == SBL__REFINE_SENSE || r->stages.stage == SBL__REFINE_SCOUT;
}

/* Returns 1 before the first round, and again when all sensors start again. */
static int sbl__refine_is_at_start(const sbl__refine *r) {
    return r->stages.stage <= SBL__REFINE_COLLECT && r->rounds == 0 && r->listed == 0;
}

static int sbl__refine_round_is_over(const sbl__refine *r) {
    return r->stages.stage == SBL__REFINE_SPEND || r->stages.stage == SBL__REFINE_RESTART;
}

/* Returns the number of looks that have been taken, with those that the job under way has finished. */
static double sbl__refine_looks_now(const sbl__refine *r) {
    const int senses = r->stages.stage == SBL__REFINE_SENSE, takes = r->stages.stage == SBL__REFINE_TAKE;
    return (double)r->looks_taken + (senses ? (double)sbl__job_progress(&r->core->job) * r->look_count : 0) +
           (takes ? (double)r->look_count * (1 - r->stages.at / SBL__MAX(1.0, (double)r->site_count)) : 0);
}

/* Returns how many looks are foreseen in all. */
static double sbl__refine_looks_expected(const sbl__refine *r) {
    const double usual = SBL__EXPECT_LOOKS * r->width * r->height, now = (double)r->looks_taken + r->look_count;
    return SBL__MAX(r->expected_looks > 0 ? r->expected_looks : usual, now);
}

/* >>refine: filling in one layer of light. It has its own stages, so that it can run at any time during refinement. */

typedef struct sbl__fill {
    /* The caller sets `refine` and `layer`; all other fields begin as 0. */
    sbl__refine *refine;
    int layer;                  /* layer of light to fill in */
    int tile, row;              /* index of the next tile; its next row of pixels */
    float *rgba;                /* output, 4 floats per pixel: light; noise of R, above 0 where there is a surface */
    int orphans;                /* number of pixels without usable light of their own or of their tile's corners */
    sbl__rings rings;           /* spread light to orphans over their surface */
} sbl__fill;

static void sbl__fill_free(sbl__base *base, sbl__fill *f) {
    sbl__free(base, f->rgba);
    sbl__rings_free(base, &f->rings);
    memset(f, 0, sizeof *f);
}

/* Returns the standard error of a pixel's luminance. predicted2: relative squared error that its tile predicts. */
static float sbl__pixel_error(const sbl__refine *r, const sbl__pixel *p, float predicted2) {
    const double unexplained = (double)SBL__PIXEL_ERROR * r->predicted;
    const double uncertainty = (double)p->uncertainty / r->luminance;
    return r->luminance * (float)sqrt((double)predicted2 + unexplained * unexplained + uncertainty * uncertainty);
}

/* Fills in a pixel by interpolation in tile c, whose sensors have all been read. parabolas: second differences of the
   tile's four edges. An orphan keeps the light of its own invalid sensor if no ring reaches it. */
static void sbl__fill_pixel(sbl__fill *f, int x, int y, const sbl__tile *c, float parabolas[4][3]) {
    sbl__refine *r = f->refine;
    sbl__pixel *p = sbl__pixel_at(r, x, y);
    float *to = f->rgba + 4 * (p - r->pixels);
    sbl__mix m;
    int k, lit = sbl__usable(p);
    memset(to, 0, 4 * sizeof *to);
    if (!p->id) return;
    p->error = sbl__pixel_error(r, p, c->bias2 + c->noise2);
    memcpy(to, sbl__pixel_light(r, p, f->layer), 3 * sizeof *to);
    if (lit) {
        const float least = r->luminance * (float)sqrt((double)c->variance * (double)sbl__variance_share(r, p->looks));
        to[3] = SBL__MAX(least, sbl__noise(r, p));  /* not below the mean noise of the tile's sensors, because the
                                                       few rays of this one may agree by chance */
        p->error = sbl__pixel_error(r, p, c->noise2);
    } else {
        sbl__interpolate(r, c, x, y, f->layer, &m);
        lit = m.covered > 0;
        for (k = 0; k < 3 && lit; k++) {
            const float *s = m.share, top = parabolas[0][k], left = parabolas[2][k];
            const float across = 0.5f * s[0] * (1 - s[0]) * (top + s[1] * (parabolas[1][k] - top));
            const float down = 0.5f * s[1] * (1 - s[1]) * (left + s[0] * (parabolas[3][k] - left));
            to[k] = sbl__clamp_light(f->layer, m.light[k] - m.own * m.own * (across + down));
        }
        to[3] = (float)sqrt(m.variance);
    }
    to[3] = SBL__MAX(to[3], SBL__LEAST_NOISE);
    if (lit) f->rings.ring[p - r->pixels] = 0;
    else f->orphans++;
}

/* Returns 1 if pixel `other` belongs to the surface of pixel `index`. */
static int sbl__fill_joined(const void *user, int index, int other) {
    const sbl__refine *r = ((const sbl__fill *)user)->refine;
    return sbl__belongs(&r->pixels[other], &r->pixels[index], r->geometry_aware) > 0;
}

/* Sets light and noise of an orphan to the mean of those neighbours on its surface that earlier rings have reached. */
static void sbl__fill_mean(void *user, int index) {
    sbl__fill *f = (sbl__fill *)user;
    const sbl__refine *r = f->refine;
    float *out = f->rgba + 4 * (size_t)index, sum[4] = { 0, 0, 0, 0 }, weights = 0;
    size_t place = 0;
    int k, other;
    while ((other = sbl__ring_grid(&f->rings, index, &place)) >= 0) {
        const float weight = sbl__ring_reached(&f->rings, other)
                           ? sbl__belongs(&r->pixels[index], &r->pixels[other], r->geometry_aware) : 0;
        for (k = 0; k < 4 && weight > 0; k++) sum[k] += weight * f->rgba[4 * (size_t)other + (size_t)k];
        weights += weight;
    }
    for (k = 0; k < 4; k++) out[k] = sum[k] / weights;
}

static sbl_result sbl__fill_make(sbl__fill *f) {
    const sbl__refine *r = f->refine;
    f->rings.user = f;
    f->rings.joined = sbl__fill_joined;
    f->rings.mean = sbl__fill_mean;
    f->rings.width = r->width;
    f->rings.last = INT_MAX;
    f->rgba = (float *)sbl__alloc_raw(&r->core->base, (size_t)r->width * (size_t)r->height, 16);
    return f->rgba ? sbl__rings_make(&r->core->base, &f->rings, r->width * r->height) : SBL_ERROR_OUT_OF_MEMORY;
}

/* Fills in f->rgba, piece by piece. A tile whose sensors have not all been read yet is filled in with the light of the
   smallest tile around it whose sensors have. */
static sbl_result sbl__fill_step(sbl__fill *f, sbl__slice *slice) {
    const sbl__refine *r = f->refine;
    const sbl_result result = f->rgba ? SBL_SUCCESS : sbl__fill_make(f);
    int x, y, k;
    if (result != SBL_SUCCESS) return result;
    for (; f->tile < r->tile_count; f->tile++, f->row = 0) {
        const sbl__tile *c = &r->tiles[f->tile];
        const sbl__range pixels = sbl__tile_pixels(r, c);
        float parabolas[4][3];
        if (c->split) continue;
        while (c->parent >= 0 && sbl__tile_corners(r, c).unread) c = &r->tiles[c->parent];
        for (k = 0; k < 4; k++) {
            const sbl__edge edge = sbl__tile_edge(r, c, k);
            sbl__edge_parabola(r, &edge, f->layer, parabolas[k]);
        }
        for (y = pixels.y[0] + f->row; y <= pixels.y[1]; y++, f->row++) {
            if (sbl__late(slice)) return SBL_UNFINISHED;
            for (x = pixels.x[0]; x <= pixels.x[1]; x++) sbl__fill_pixel(f, x, y, c, parabolas);
        }
    }
    return f->orphans ? sbl__rings_step(&f->rings, slice) : SBL_SUCCESS;
}

/* ======================================================================================================== >>filter
   Smooths R with a Gaussian (section III-H) that stops at edges. */

/* >>glsl belongs: shaders_embedded/belongs.glsl, copied by scripts/embed_shaders */
static const char *const sbl__glsl_belongs[] = {
"// Returns how far two surface points with the same id belong to one smooth surface, 0 to 1, by their normals n and\n",
"// m and by the distance of each point from the other's plane. sbl__belongs in sbl.h does the same on the CPU.\n",
"float sbl_belongs(vec3 p, vec3 n, vec3 q, vec3 m) {\n",
"    float turn = clamp((dot(n, m) - SBL_BELONGS_COSINE) / SBL_BELONGS_TURN, 0.0, 1.0);\n",
"    vec3 d = q - p;\n",
"    float off = max(abs(dot(d, n)), abs(dot(d, m))), apart = length(d);\n",
"    return turn * turn * clamp(2.0 - SBL_BELONGS_OFF * off / max(apart, SBL_DIVISOR_LEAST), 0.0, 1.0);\n",
"}\n",
0 };
/* <<glsl */

/* >>glsl filter: shaders_embedded/filter.glsl, copied by scripts/embed_shaders */
static const char *const sbl__glsl_filter[] = {
"// The Gaussian of section III-H over pixels with the same id, normalised. Outside paper mode, weights are also\n",
"// reduced for pixels whose normal or plane differs, or whose R or harmonics differ by more than noise explains.\n",
"uniform sampler2D radiance;  // R; a: its noise, above 0 where there is a surface\n",
"uniform sampler2D layer;     // SBL_DIRECTIONAL: a layer of harmonics, which is smoothed instead of R\n",
"uniform sampler2D positions, normals;\n",
"uniform usampler2D ids;\n",
"uniform int radius;\n",
"uniform float falloff;       // 1 / (2 sigma^2), sigma in pixels\n",
"uniform int geometry_aware;\n",
"layout(location = 0) out vec4 out_radiance;\n",
"\n",
"uniform float layer_noise;   // noise of harmonics / R in pixels where R has no noise, see sbl__spec_layer_noise\n",
"const float SBL_HARMONIC = 2.0;  // noise of a harmonic divided by the noise of R, approximately\n",
"\n",
"// Returns the approximate noise of a harmonic. r: R and its noise\n",
"float sbl_harmonic_noise(vec4 r) { return SBL_HARMONIC * r.a + layer_noise * max(r.r, max(r.g, r.b)); }\n",
"\n",
"// Returns about 1 if noise explains the difference of two pixels, about 0 if it is several times the noise.\n",
"float sbl_alike(vec4 a, vec4 b) {\n",
"    vec3 apart = abs(a.rgb - b.rgb), c = abs(a.rgb), d = abs(b.rgb);\n",
"    float noise = a.a + b.a + SBL_FILTER_VISIBLE * (max(c.r, max(c.g, c.b)) + max(d.r, max(d.g, d.b)));\n",
"    float difference = max(apart.r, max(apart.g, apart.b)) / max(noise, SBL_DIVISOR_LEAST);\n",
"    return exp(-SBL_FILTER_FALL * difference * difference);\n",
"}\n",
"\n",
"void main() {\n",
"    ivec2 at = ivec2(gl_FragCoord.xy), size = textureSize(radiance, 0);\n",
"    uint id = texelFetch(ids, at, 0).x;\n",
"    out_radiance = vec4(0);\n",
"    if (id == 0u) return;\n",
"    vec3 p = texelFetch(positions, at, 0).xyz, n = texelFetch(normals, at, 0).xyz;\n",
"    vec4 sum = vec4(0), own = texelFetch(radiance, at, 0);\n",
"#ifdef SBL_DIRECTIONAL\n",
"    vec4 own_layer = vec4(texelFetch(layer, at, 0).rgb, sbl_harmonic_noise(own));\n",
"#endif\n",
"    for (int y = max(-radius, -at.y); y <= min(radius, size.y - 1 - at.y); y++)\n",
"        for (int x = max(-radius, -at.x); x <= min(radius, size.x - 1 - at.x); x++) {\n",
"            ivec2 there = at + ivec2(x, y);\n",
"            if (texelFetch(ids, there, 0).x != id) continue;\n",
"            vec4 light = texelFetch(radiance, there, 0);\n",
"            float weight = exp(-falloff * float(x * x + y * y));\n",
"            if (geometry_aware != 0 && (x != 0 || y != 0))\n",
"                weight *= sbl_belongs(p, n, texelFetch(positions, there, 0).xyz,\n",
"                                      texelFetch(normals, there, 0).xyz) *\n",
"                          sbl_alike(own, light);\n",
"#ifdef SBL_DIRECTIONAL\n",
"            light = vec4(texelFetch(layer, there, 0).rgb, sbl_harmonic_noise(light));\n",
"            weight *= sbl_alike(own_layer, light);\n",
"#endif\n",
"            sum += weight * vec4(light.rgb, 1);\n",
"        }\n",
"    out_radiance = vec4(sum.rgb / sum.a, 1);\n",
"}\n",
0 };
/* <<glsl */

static const sbl__recipe sbl__recipe_filter = {
    "filter", { sbl__glsl_fullscreen_vertex }, { sbl__glsl_belongs, sbl__glsl_filter }, { NULL }, SBL__DIRECTIONAL
};

typedef struct sbl__filter {
    int radius, geometry_aware;
    const sbl__texture *radiance;  /* R and its noise */
    const sbl__texture *layer;     /* the layer of harmonics to smooth; NULL: smooth R */
    float layer_noise;             /* see sbl__spec_layer_noise */
} sbl__filter;

static double sbl__filter_sigma(int radius) { return SBL__MAX(0.5 * radius, 0.1); }

/* Returns the number of pixels whose plain mean would reduce independent noise as much as the filter does. */
static float sbl__filter_pixels(int radius) {
    const double sigma = sbl__filter_sigma(radius);
    double sum = 0, squares = 0;
    int x;
    for (x = -SBL__MAX(radius, 0); x <= SBL__MAX(radius, 0); x++) {
        const double weight = exp(-x * x / (2 * sigma * sigma));
        sum += weight;
        squares += weight * weight;
    }
    return (float)((sum * sum / squares) * (sum * sum / squares));
}

/* Smooths rows of pixels. rows: first row, number of rows */
static sbl_result sbl__filter_draw(sbl__device *d, const sbl__filter *f, const sbl__gbuffer *g,
                                   const sbl__target *out, const int rows[2]) {
    const double sigma = sbl__filter_sigma(f->radius);
    const sbl_result result = sbl__use(d, &sbl__recipe_filter, f->layer ? (unsigned)SBL__DIRECTIONAL : 0);
    if (result != SBL_SUCCESS) return result;
    sbl__pass_rows(d, out, rows[0], rows[1]);
    sbl__bind(d, "radiance", f->radiance);
    if (f->layer) sbl__bind(d, "layer", f->layer);
    sbl__set_float(d, "layer_noise", f->layer_noise);
    sbl__bind(d, "positions", &g->textures[SBL__GBUFFER_POSITION]);
    sbl__bind(d, "normals", &g->textures[SBL__GBUFFER_NORMAL]);
    sbl__bind(d, "ids", &g->textures[SBL__GBUFFER_ID]);
    sbl__set_int(d, "radius", f->radius);
    sbl__set_float(d, "falloff", (float)(1 / (2 * sigma * sigma)));
    sbl__set_int(d, "geometry_aware", f->geometry_aware);
    sbl__draw_screen(d);
    return SBL_SUCCESS;
}

/* ======================================================================================================== >>resolve
   Computes the picture from R and the G-buffers of all samples: composition (section III-H) and anti-aliasing. */

/* >>glsl tone: shaders_embedded/tone.glsl, copied by scripts/embed_shaders */
static const char *const sbl__glsl_tone[] = {
"// View transforms: radiance becomes what a screen shows, linear, 0 to 1.\n",
"uniform int tone;                    // sbl_tone\n",
"uniform float exposure;              // factor applied to radiance\n",
"const int SBL_TONE_NEUTRAL = 2, SBL_TONE_AGX = 3;\n",
"const float SBL_TONE_MOST = 1e8;     // greater values are cut, so that no difference below is infinite\n",
"\n",
"// PBR Neutral (Khronos Group 2024): keeps colours as they are up to about 0.8, and fades brighter ones to white.\n",
"const float SBL_NEUTRAL_TOE = 0.08, SBL_NEUTRAL_KNEE = 0.76, SBL_NEUTRAL_FADE = 0.15;\n",
"\n",
"vec3 sbl_neutral(vec3 c) {\n",
"    float least = min(c.r, min(c.g, c.b)), room = 1.0 - SBL_NEUTRAL_KNEE;\n",
"    c -= least < SBL_NEUTRAL_TOE ? least - least * least / (2.0 * SBL_NEUTRAL_TOE) : 0.5 * SBL_NEUTRAL_TOE;\n",
"    float peak = max(c.r, max(c.g, c.b));\n",
"    if (peak <= SBL_NEUTRAL_KNEE) return c;\n",
"    float shown = 1.0 - room * room / (peak + room - SBL_NEUTRAL_KNEE);\n",
"    return mix(vec3(shown), c * (shown / peak), 1.0 / (SBL_NEUTRAL_FADE * (peak - shown) + 1.0));\n",
"}\n",
"\n",
"// AgX (Sobotka 2022): mixes the primaries a little, so that bright colours fade to white as on film, then applies\n",
"// a sigmoid to the logarithm, from 10 stops below middle grey (0.18) to 6.5 stops above it. The columns of the\n",
"// matrices are what red, green and blue become.\n",
"const mat3 SBL_AGX_MIX = mat3(0.842401, 0.042401, 0.042401, 0.078437, 0.878437, 0.078437,\n",
"                              0.079162, 0.079162, 0.879162);\n",
"const mat3 SBL_AGX_UNMIX = mat3(1.196999, -0.053001, -0.053001, -0.098046, 1.151954, -0.098046,\n",
"                                -0.098953, -0.098953, 1.151047);\n",
"const float SBL_AGX_GREY = 10.0 / 16.5;\n",
"\n",
"// Returns 2 x / (1 + a x^power)^(1 / power), where a makes the value at x = end equal to 0.5.\n",
"vec3 sbl_agx_half(vec3 x, float end, float power) {\n",
"    float a = (pow(4.0 * end, power) - 1.0) / pow(end, power);\n",
"    return 2.0 * x * pow(1.0 + a * pow(x, vec3(power)), vec3(-1.0 / power));\n",
"}\n",
"\n",
"vec3 sbl_agx(vec3 c) {\n",
"    vec3 stops = log2(max(SBL_AGX_MIX * c, 1e-10) / 0.18);\n",
"    vec3 x = clamp(stops / 16.5 + SBL_AGX_GREY, 0.0, 1.0) - SBL_AGX_GREY;\n",
"    vec3 sigmoid = 0.5 + sbl_agx_half(max(x, 0.0), 1.0 - SBL_AGX_GREY, 3.25) -\n",
"                   sbl_agx_half(max(-x, 0.0), SBL_AGX_GREY, 3.0);\n",
"    return pow(max(SBL_AGX_UNMIX * sigmoid, 0.0), vec3(2.2));\n",
"}\n",
"\n",
"vec3 sbl_shown(vec3 radiance) {\n",
"    vec3 c = min(max(radiance * exposure, 0.0), SBL_TONE_MOST);\n",
"    return clamp(tone == SBL_TONE_NEUTRAL ? sbl_neutral(c) : tone == SBL_TONE_AGX ? sbl_agx(c) : c, 0.0, 1.0);\n",
"}\n",
0 };
/* <<glsl */

/* >>glsl resolve: shaders_embedded/resolve.glsl, copied by scripts/embed_shaders */
static const char *const sbl__glsl_resolve[] = {
"// Composition (section III-H) of one anti-aliasing sample of every pixel: emission plus reflected light. The\n",
"// sample has its own G-buffer; its R comes from the nearest pixel centres that show the same surface, so that\n",
"// light does not bleed over edges.\n",
"uniform sampler2D radiance;                 // R at pixel centres\n",
"uniform sampler2D positions, normals;       // at pixel centres\n",
"uniform usampler2D ids;\n",
"uniform sampler2D sample_positions, sample_normals, sample_albedo, sample_emission;\n",
"uniform usampler2D sample_ids;\n",
"uniform vec2 offset;                        // position of the sample relative to the pixel's centre, pixels\n",
"uniform sampler2D previous;                 // sum of the samples before, each times `share`\n",
"uniform int has_previous;                   // 0: this is the first sample\n",
"uniform float share;                        // 1 / number of samples per pixel\n",
"layout(location = 0) out vec4 out_color;\n",
"#ifdef SBL_DISPLAY\n",
"uniform sampler2D previous_display;         // like `previous`, of what the screen shows\n",
"layout(location = 1) out vec4 out_display;\n",
"#endif\n",
"\n",
"const int SBL_REACH = 2;                // R is taken from pixels at most this far away in x and y\n",
"const float SBL_NEAR_ENOUGH = 0.05;     // least sum of weights at which the four nearest pixels suffice\n",
"const float SBL_SAME_ID = 1e-3;         // weight of a pixel with the same id that does not belong to the surface\n",
"const float SBL_OTHER_ID = 0.01;        // + cosine of the normals: weight of a pixel if none has the sample's id\n",
"\n",
"// Returns the radiance of the environment picture in a direction, bilinearly filtered.\n",
"vec3 sbl_sky_smooth(vec3 direction) {\n",
"    vec3 radiance = vec3(0);\n",
"    ivec2 size = textureSize(sky_picture, 0);\n",
"    vec2 at = sbl_sky_at(direction) * vec2(size) - 0.5, corner = floor(at), f = at - corner;\n",
"    for (int i = 0; i < (sky_limit == 0.0 ? 0 : 4); i++) {\n",
"        ivec2 step = ivec2(i & 1, i >> 1), texel = ivec2(corner) + step;\n",
"        vec2 weight = mix(1.0 - f, f, vec2(step));\n",
"        texel = ivec2((texel.x + size.x) % size.x, clamp(texel.y, 0, size.y - 1));\n",
"        radiance += weight.x * weight.y * texelFetch(sky_picture, texel, 0).rgb;\n",
"    }\n",
"    return radiance;\n",
"}\n",
"\n",
"// Returns R at the sample: from those of the four nearest pixels that belong to its surface; if their weight is\n",
"// too small, from pixels with its id within SBL_REACH; if there are none, from all pixels there.\n",
"vec3 sbl_light_at(ivec2 at, uint id) {\n",
"    ivec2 size = textureSize(radiance, 0), least = at + ivec2(floor(offset));\n",
"    vec3 p = texelFetch(sample_positions, at, 0).xyz, n = texelFetch(sample_normals, at, 0).xyz;\n",
"    vec4 near = vec4(0);\n",
"    for (int i = 0; i < 4; i++) {\n",
"        ivec2 there = clamp(least + ivec2(i & 1, i >> 1), ivec2(0), size - 1);\n",
"        if (texelFetch(ids, there, 0).x != id) continue;\n",
"        vec2 tent = 1.0 - abs(vec2(least + ivec2(i & 1, i >> 1) - at) - offset);\n",
"        near += tent.x * tent.y * vec4(texelFetch(radiance, there, 0).rgb, 1) *\n",
"                sbl_belongs(p, n, texelFetch(positions, there, 0).xyz, texelFetch(normals, there, 0).xyz);\n",
"    }\n",
"    bool enough = near.a > SBL_NEAR_ENOUGH;\n",
"    int across = 2 * SBL_REACH + 1, count = enough ? 0 : across * across;\n",
"    vec4 far = vec4(0), rest = vec4(0);\n",
"    for (int i = 0; i < count; i++) {\n",
"        ivec2 step = ivec2(i % across, i / across) - SBL_REACH, there = clamp(at + step, ivec2(0), size - 1);\n",
"        uint there_id = texelFetch(ids, there, 0).x;\n",
"        if (there_id == 0u) continue;\n",
"        vec3 q = texelFetch(positions, there, 0).xyz, m = texelFetch(normals, there, 0).xyz;\n",
"        vec2 d = vec2(step) - offset;\n",
"        vec4 r = exp(-dot(d, d)) * vec4(texelFetch(radiance, there, 0).rgb, 1);\n",
"        if (there_id == id) far += r * (sbl_belongs(p, n, q, m) + SBL_SAME_ID);\n",
"        rest += r * (SBL_OTHER_ID + max(0.0, dot(n, m)));\n",
"    }\n",
"    vec4 light = enough ? near : far.a > 0.0 ? far : rest;\n",
"    return light.a > 0.0 ? light.rgb / light.a : vec3(0);\n",
"}\n",
"\n",
"void main() {\n",
"    ivec2 at = ivec2(gl_FragCoord.xy);\n",
"    uint id = texelFetch(sample_ids, at, 0).x;\n",
"    vec4 before = has_previous == 0 ? vec4(0) : texelFetch(previous, at, 0);\n",
"    vec3 color;\n",
"    if (id == 0u) color = sky + sbl_sky_smooth(sbl_camera_direction());\n",
"    else {\n",
"        vec3 light = offset == vec2(0) ? texelFetch(radiance, at, 0).rgb : sbl_light_at(at, id);\n",
"        sbl_Material material = sbl_Material(texelFetch(sample_albedo, at, 0).rgb, false);\n",
"        color = texelFetch(sample_emission, at, 0).rgb + sbl_reflected(material, light);\n",
"    }\n",
"    out_color = before + share * vec4(color, 1);\n",
"#ifdef SBL_DISPLAY\n",
"    vec4 shown_before = has_previous == 0 ? vec4(0) : texelFetch(previous_display, at, 0);\n",
"    out_display = shown_before + share * vec4(sbl_shown(color), 1);\n",
"#endif\n",
"}\n",
0 };
/* <<glsl */

static const sbl__recipe sbl__recipe_resolve = {
    "resolve", { sbl__glsl_fullscreen_vertex },
    { sbl__glsl_scene, sbl__glsl_frame, sbl__glsl_material, sbl__glsl_belongs, sbl__glsl_camera, sbl__glsl_sky,
      sbl__glsl_tone, sbl__glsl_resolve }, { &sbl__object_record }, SBL__DISPLAY
};

/* Gets the position of sample i of `count` relative to the pixel's centre, in pixels: the R2 sequence (Roberts 2018,
   "The Unreasonable Effectiveness of Quasirandom Sequences"). A single sample lies at the centre. */
static void sbl__sample_offset(int i, int count, float out[2]) {
    double x = 0.5 + (i + 0.5) * 0.7548776662466927, y = 0.5 + (i + 0.5) * 0.5698402909980532;
    out[0] = count == 1 ? 0 : (float)(x - floor(x) - 0.5);
    out[1] = count == 1 ? 0 : (float)(y - floor(y) - 0.5);
}

/* One anti-aliasing sample, of all pixels. */
typedef struct sbl__resolve {
    const sbl__gbuffer *centres, *sample;  /* G-buffers of the pixels' centres and of the sample */
    const sbl__texture *radiance;          /* R at pixel centres */
    const sbl__texture *previous;          /* [0]: sum of the samples before, each divided by `count`; [1]: the same of
                                              what a screen shows */
    const sbl__environment *environment;
    const sbl__camera *camera;
    int index, count;                      /* number of the anti-aliasing sample, from 0; number of all samples */
    sbl_tone tone;                         /* SBL_TONE_NONE: only radiance is composed */
    float stops;                           /* exposure of what a screen shows */
} sbl__resolve;

/* Writes r->previous + sample / r->count to rows of `out`. rows: first row, number of rows */
static sbl_result sbl__resolve_draw(sbl__device *d, const sbl__resolve *r, const sbl__target *out, const int rows[2]) {
    const int shown = r->tone != SBL_TONE_NONE;
    const sbl_result result = sbl__use(d, &sbl__recipe_resolve, shown ? (unsigned)SBL__DISPLAY : 0);
    float offset[2];
    if (result != SBL_SUCCESS) return result;
    sbl__sample_offset(r->index, r->count, offset);
    sbl__pass_rows(d, out, rows[0], rows[1]);
    sbl__bind(d, "radiance", r->radiance);
    sbl__bind(d, "positions", &r->centres->textures[SBL__GBUFFER_POSITION]);
    sbl__bind(d, "normals", &r->centres->textures[SBL__GBUFFER_NORMAL]);
    sbl__bind(d, "ids", &r->centres->textures[SBL__GBUFFER_ID]);
    sbl__bind(d, "sample_positions", &r->sample->textures[SBL__GBUFFER_POSITION]);
    sbl__bind(d, "sample_normals", &r->sample->textures[SBL__GBUFFER_NORMAL]);
    sbl__bind(d, "sample_albedo", &r->sample->textures[SBL__GBUFFER_ALBEDO]);
    sbl__bind(d, "sample_emission", &r->sample->textures[SBL__GBUFFER_EMISSION]);
    sbl__bind(d, "sample_ids", &r->sample->textures[SBL__GBUFFER_ID]);
    sbl__bind(d, "previous", &r->previous[0]);
    if (shown) {
        sbl__bind(d, "previous_display", &r->previous[1]);
        sbl__set_int(d, "tone", (int)r->tone);
        sbl__set_float(d, "exposure", (float)pow(2, (double)r->stops));
    }
    sbl__environment_bind(d, r->environment);
    sbl__camera_set(d, r->camera, offset, out);
    sbl__set_vec2(d, "offset", offset[0], offset[1]);
    sbl__set_int(d, "has_previous", r->index > 0);
    sbl__set_float(d, "share", 1.0f / (float)r->count);
    sbl__draw_screen(d);
    return SBL_SUCCESS;
}

/* ======================================================================================================== >>gutters
   Continues a lightmap beyond its charts, ring by ring. Each texel of a ring gets the mean of those of its eight
   neighbours that are on a chart or in an earlier ring. */

typedef struct sbl__gutters {
    int size[2];               /* width and height, texels */
    float *light;              /* 4 floats per texel: light of a layer, and the texel's ring: 0 on charts, -1: none */
    sbl__rings spread;
} sbl__gutters;

static void sbl__gutters_free(sbl__base *base, sbl__gutters *g) {
    sbl__free(base, g->light);
    sbl__rings_free(base, &g->spread);
    memset(g, 0, sizeof *g);
}

static void sbl__gutters_mean(void *user, int texel) {
    sbl__gutters *g = (sbl__gutters *)user;
    float *out = g->light + 4 * (size_t)texel, sum[3] = { 0, 0, 0 };
    size_t place = 0;
    int i, count = 0, other;
    while ((other = sbl__ring_grid(&g->spread, texel, &place)) >= 0) {
        if (!sbl__ring_reached(&g->spread, other)) continue;
        for (i = 0; i < 3; i++) sum[i] += g->light[4 * (size_t)other + (size_t)i];
        count++;
    }
    for (i = 0; i < 3; i++) out[i] = sum[i] / (float)count;
    out[3] = (float)g->spread.number;
}

static sbl_result sbl__gutters_begin(sbl__base *base, sbl__gutters *g, const int size[2], int rings) {
    const size_t texels = (size_t)size[0] * (size_t)size[1];
    g->spread.last = rings;
    g->size[0] = g->spread.width = size[0];
    g->size[1] = size[1];
    g->spread.user = g;
    g->spread.mean = sbl__gutters_mean;
    g->light = (float *)sbl__alloc_raw(base, texels, 16);
    return g->light ? sbl__rings_make(base, &g->spread, (int)texels) : SBL_ERROR_OUT_OF_MEMORY;
}

/* Makes texels on charts the start of the rings. Before, g->light holds the output of the filter: light, and as fourth
   float 1 on charts. The fourth float becomes the texel's ring. first, count: range of texels */
static void sbl__gutters_put(sbl__gutters *g, int first, int count) {
    int i;
    for (i = first; i < first + count; i++) {
        float *ring = &g->light[4 * (size_t)i + 3];
        if (*ring > 0) g->spread.ring[i] = 0;
        *ring = (float)g->spread.ring[i];
    }
}

/* ======================================================================================================== >>seams
   Changes a lightmap as little as possible so that bilinear samples are equal on both sides of each seam (Iwanicki,
   "Lighting technology of The Last of Us", SIGGRAPH 2013). Conjugate gradients find the texels x that minimise

       sum over points of seams of (A x - B x)^2   +   SBL__SEAM_KEEP * sum over texels of (x - x0)^2

   where A and B are the bilinear weights at the point's two places in the map. Channels that become negative are set to
   0 and kept there while the rest is solved again. Seams are edges of triangles with the same ends and normals in the
   world, but not in the map: where normals differ, light may differ. Points where light differs much are left alone,
   because something stands between, such as a wall on a floor that is divided beneath it. */

#define SBL__SEAM_KEEP 0.0002
#define SBL__SEAM_POINTS 2        /* points per texel of a seam's length */
#define SBL__SEAM_POINTS_MOST 65536  /* maximum number of points per seam */
#define SBL__SEAM_TURN 0.998      /* normals are the same if their cosine is above this */
#define SBL__SEAM_DIFFERENT 0.5f  /* light differs much if it differs by more than this share of the brighter side */
#define SBL__SEAM_CHAIN 16        /* maximum number of edges with the same ends that an edge is compared with */
#define SBL__SEAM_ROUNDS 4        /* maximum number of solutions per layer */
#define SBL__SEAM_PRECISION2 1e-10

/* A point of a seam. Entries 0 to 3 are for its place A in the map, 4 to 7 for B; the weights of B are negative.
   unknowns: texels until the point is added, then numbers of unknowns */
typedef struct sbl__seam_point { int unknowns[8]; float weights[8]; } sbl__seam_point;

enum { SBL__SEAMS_EDGES, SBL__SEAMS_BEFORE, SBL__SEAMS_SOLVE, SBL__SEAMS_APPLY, SBL__SEAMS_AFTER, SBL__SEAMS_DONE };

typedef struct sbl__seams {
    sbl__stages stages;
    const sbl__atlas *atlas;
    const sbl__gutters *light;
    sbl__hash_table edges;      /* sides of baked triangles, by the positions of their ends */
    sbl__seam_point *points;
    int point_count, point_room;
    int *unknown_of;            /* per texel: 1 + its number among the unknowns; 0: the texel does not change */
    int *texels;                /* per unknown: its texel */
    int unknown_count, unknown_room;
    sbl__solver solver;         /* finds the change of 3 channels per unknown; diagonal 0: the channel is kept at 0 */
    int seams;                  /* number of seams, each a pair of edges */
    int layer;                  /* index of the layer being sewn: 0 is R; the others are harmonics, maybe negative */
    int rounds;                 /* how many solutions of this layer have made channels negative so far */
    int bound;                  /* 1 if the last solution made channels negative, which then were set to 0 */
    float before, after;        /* largest |luminance| of a difference across a seam, before the first solution and
                                   after the last; not relative */
} sbl__seams;

static void sbl__seams_free(sbl__base *base, sbl__seams *s) {
    sbl__hash_table_free(base, &s->edges);
    sbl__free(base, s->points);
    sbl__free(base, s->unknown_of);
    sbl__free(base, s->texels);
    sbl__solver_free(base, &s->solver);
    memset(s, 0, sizeof *s);
}

/* >>seams: edges */

/* Gets the two vertices of an edge, ordered by position, so that both sides of a seam have the same order. */
static void sbl__seam_ends(const sbl__geometry *g, uint32_t edge, uint32_t ends[2]) {
    const uint32_t first = sbl__side_end(g->indices, edge, 0), second = sbl__side_end(g->indices, edge, 1);
    const float *a = g->vertices[first].position, *b = g->vertices[second].position;
    int k, swapped;
    for (k = 0; k < 2 && !(a[k] < b[k]) && !(b[k] < a[k]); k++) {}
    swapped = b[k] < a[k];
    ends[swapped] = first;
    ends[!swapped] = second;
}

/* Gets the unit normal at an end of an edge: the vertex normal or, if that is 0, the triangle's. */
static void sbl__seam_normal(const sbl__geometry *g, uint32_t edge, uint32_t vertex, double out[3]) {
    int k;
    for (k = 0; k < 3; k++) out[k] = (double)g->attributes[vertex].normal[k];
    if (!sbl__normalize(out)) sbl__scene_normal(g, edge / 3, out);
}

/* Returns 0 if two edges have different ends in the world, 2 if they are a seam: the places in the map differ and the
   normals are the same; otherwise 1. */
static int sbl__seam_match(const sbl__geometry *g, const uint32_t edges[2], const uint32_t ends[2][2]) {
    int i, parted = 0, alike = 1;
    for (i = 0; i < 2; i++) {
        const uint32_t a = ends[0][i], b = ends[1][i];
        double m[3], n[3];
        if (!sbl__same_floats(g->vertices[a].position, g->vertices[b].position, 3)) return 0;
        if (!sbl__same_floats(sbl__atlas_uv(g, a), sbl__atlas_uv(g, b), 2)) parted = 1;
        sbl__seam_normal(g, edges[0], a, m);
        sbl__seam_normal(g, edges[1], b, n);
        alike = alike && m[0] * n[0] + m[1] * n[1] + m[2] * n[2] > SBL__SEAM_TURN;
    }
    return parted && alike ? 2 : 1;
}

/* Stores the four texels around a place in the map (at, in texels) and their bilinear weights as one side of a point.
   Returns 0 if one of these texels has no light. */
static int sbl__seam_mix(const sbl__gutters *g, const double at[2], int side, sbl__seam_point *p) {
    int low[2], high[2], i, k;
    double share[2];
    for (k = 0; k < 2; k++) {
        const double x = SBL__MIN(SBL__MAX(at[k] - 0.5, 0.0), g->size[k] - 1.0);
        low[k] = (int)x;
        high[k] = SBL__MIN(low[k] + 1, g->size[k] - 1);
        share[k] = x - low[k];
    }
    for (i = 0; i < 4; i++) {
        const int texel = (i & 2 ? high[1] : low[1]) * g->size[0] + (i & 1 ? high[0] : low[0]);
        const double weight = (i & 1 ? share[0] : 1 - share[0]) * (i & 2 ? share[1] : 1 - share[1]);
        if (g->light[4 * (size_t)texel + 3] < 0) return 0;
        p->unknowns[4 * side + i] = texel;
        p->weights[4 * side + i] = (float)(side ? -weight : weight);
    }
    return 1;
}

/* Returns 1 if the light on both sides of a point does not differ much. p->unknowns holds texels. */
static int sbl__seam_is_even(const sbl__gutters *g, const sbl__seam_point *p) {
    float sides[2] = { 0, 0 };
    int i;
    for (i = 0; i < 8; i++)
        sides[i / 4] += (float)fabs((double)p->weights[i]) * sbl__luminance(g->light + 4 * (size_t)p->unknowns[i]);
    return fabs((double)sides[0] - sides[1]) <= (double)(SBL__SEAM_DIFFERENT * SBL__MAX(sides[0], sides[1]));
}

/* Adds a point and numbers its unknowns. */
static sbl_result sbl__seam_add(sbl__seams *s, const sbl__seam_point *p) {
    sbl__base *base = s->atlas->base;
    sbl__seam_point *out;
    int i;
    if (!sbl__grow(base, &s->points, &s->point_room, s->point_count + 1, sizeof *s->points) ||
        !sbl__grow(base, &s->texels, &s->unknown_room, s->unknown_count + 8, sizeof *s->texels))
        return SBL_ERROR_OUT_OF_MEMORY;
    out = &s->points[s->point_count++];
    *out = *p;
    for (i = 0; i < 8; i++) {
        int *number = &s->unknown_of[p->unknowns[i]];
        if (!*number) {
            s->texels[s->unknown_count++] = p->unknowns[i];
            *number = s->unknown_count;
        }
        out->unknowns[i] = *number - 1;
    }
    return SBL_SUCCESS;
}

/* Adds points along a seam. ends: two vertices per side */
static sbl_result sbl__seam_points(sbl__seams *s, const uint32_t ends[2][2]) {
    double places[2][2][2], longest = 0;  /* [side][end]: x and y in the map, texels */
    int side, k, i, count;
    for (side = 0; side < 2; side++) {
        double dx, dy;
        for (i = 0; i < 4; i++)
            places[side][i / 2][i % 2] = (double)sbl__atlas_uv(s->atlas->geometry, ends[side][i / 2])[i % 2] *
                                         s->light->size[i % 2];
        dx = places[side][1][0] - places[side][0][0];
        dy = places[side][1][1] - places[side][0][1];
        longest = SBL__MAX(longest, sqrt(dx * dx + dy * dy));
    }
    count = (int)SBL__MIN(SBL__SEAM_POINTS * longest + 1, SBL__SEAM_POINTS_MOST);
    s->seams++;
    for (i = 0; i < count; i++) {
        const double t = (i + 0.5) / count;
        sbl__seam_point point;
        int whole = 1;
        for (side = 0; side < 2; side++) {
            double at[2];
            for (k = 0; k < 2; k++) at[k] = (1 - t) * places[side][0][k] + t * places[side][1][k];
            whole = whole && sbl__seam_mix(s->light, at, side, &point);
        }
        if (whole && sbl__seam_is_even(s->light, &point) && sbl__seam_add(s, &point) != SBL_SUCCESS)
            return SBL_ERROR_OUT_OF_MEMORY;
    }
    return SBL_SUCCESS;
}

/* Adds points along the seams between an edge and the edges in s->edges, then adds the edge to s->edges. */
static sbl_result sbl__seams_edge(void *work, int edge) {
    sbl__seams *s = (sbl__seams *)work;
    const sbl__geometry *g = s->atlas->geometry;
    uint32_t edges[2], ends[2][2], slot;
    int looked = 0, match;
    if (!sbl__atlas_is_baked(s->atlas, g->indices[edge])) return SBL_SUCCESS;
    edges[0] = (uint32_t)edge;
    edges[1] = 0;
    sbl__seam_ends(g, edges[0], ends[0]);
    slot = sbl__hash_floats(0, g->vertices[ends[0][0]].position, 3);
    slot = sbl__hash_floats(slot, g->vertices[ends[0][1]].position, 3);
    while (looked < SBL__SEAM_CHAIN && (edges[1] = sbl__slot_next(&s->edges, &slot)) != SBL__NONE) {
        sbl__seam_ends(g, edges[1], ends[1]);
        match = sbl__seam_match(g, edges, (const uint32_t (*)[2])ends);
        looked += match > 0;
        if (match == 2 && sbl__seam_points(s, (const uint32_t (*)[2])ends) != SBL_SUCCESS)
            return SBL_ERROR_OUT_OF_MEMORY;
    }
    if (edges[1] == SBL__NONE) sbl__slot_fill(&s->edges, slot, edges[0]);
    return SBL_SUCCESS;
}

/* >>seams: the solution */

/* Adds a point's term of the matrix, times the direction, to the product. */
static void sbl__seam_term(void *user, int point, const double *direction, double *product) {
    const sbl__seam_point *p = &((sbl__seams *)user)->points[point];
    double difference[3] = { 0, 0, 0 };
    int i;
    for (i = 0; i < 24; i++)
        difference[i % 3] += (double)p->weights[i / 3] * direction[3 * (size_t)p->unknowns[i / 3] + (size_t)i % 3];
    for (i = 0; i < 24; i++)
        product[3 * (size_t)p->unknowns[i / 3] + (size_t)i % 3] += (double)p->weights[i / 3] * difference[i % 3];
}

/* Measures the difference of light across the seam at a point. If a solution follows, also adds the point to the
   right-hand side; if it is the first of a layer, marks all channels of the point's texels as free to change. */
static sbl_result sbl__seam_measure(void *work, int point) {
    sbl__seams *s = (sbl__seams *)work;
    const sbl__seam_point *p = &s->points[point];
    const int after = s->stages.stage == SBL__SEAMS_AFTER;
    double d[3] = { 0, 0, 0 };
    float difference[3], jump;
    int i;
    for (i = 0; i < 24; i++) {
        const float *light = s->light->light + 4 * (size_t)s->texels[p->unknowns[i / 3]];
        d[i % 3] += (double)p->weights[i / 3] * light[i % 3];
    }
    for (i = 0; i < 3; i++) difference[i] = (float)d[i];
    jump = (float)fabs((double)sbl__luminance(difference));
    if (after) s->after = SBL__MAX(s->after, jump);
    else if (!s->rounds) s->before = SBL__MAX(s->before, jump);
    for (i = 0; i < 24 && !after; i++) {
        const size_t at = 3 * (size_t)p->unknowns[i / 3] + (size_t)i % 3;
        s->solver.residual[at] -= (double)p->weights[i / 3] * d[i % 3];
        if (!s->rounds) s->solver.diagonal[at] = 1;
    }
    return SBL_SUCCESS;
}

/* Adds the solution to a texel. Channels of R that become negative are set to 0 and kept there. */
static sbl_result sbl__seam_apply(void *work, int unknown) {
    sbl__seams *s = (sbl__seams *)work;
    float *texel = s->light->light + 4 * (size_t)s->texels[unknown];
    size_t i = 3 * (size_t)unknown;
    int k;
    for (k = 0; k < 3; k++, i++) {
        const double light = (double)texel[k] + s->solver.solution[i];
        if (light < 0 && s->layer == 0) {
            s->solver.diagonal[i] = 0;
            s->bound = 1;
        }
        texel[k] = (float)light;
        if (s->layer == 0) texel[k] = SBL__MAX(texel[k], 0.0f);
        s->solver.solution[i] = s->solver.residual[i] = 0;
    }
    return SBL_SUCCESS;
}

static sbl_result sbl__seams_make(void *work, sbl__slice *slice) {
    sbl__seams *s = (sbl__seams *)work;
    const sbl__geometry *g = s->atlas->geometry;
    double edges = 0;
    int i;
    (void)slice;
    if (s->unknown_of) return SBL_SUCCESS;
    for (i = 0; i < g->mesh_count; i++) if (s->atlas->baked[i]) edges += 3.0 * g->meshes[i].triangle_count;
    s->unknown_of = (int *)sbl__alloc(s->atlas->base, (size_t)s->light->spread.count, sizeof *s->unknown_of);
    return s->unknown_of ? sbl__hash_table_make(s->atlas->base, &s->edges, edges) : SBL_ERROR_OUT_OF_MEMORY;
}

static sbl_result sbl__seams_make_solver(void *work, sbl__slice *slice) {
    sbl__seams *s = (sbl__seams *)work;
    (void)slice;
    if (s->solver.user) return SBL_SUCCESS;  /* the solver was made for layer 0 */
    s->solver.user = s;
    s->solver.term = sbl__seam_term;
    s->solver.term_count = s->point_count;
    s->solver.together = 1;
    s->solver.identity = SBL__SEAM_KEEP;
    s->solver.precision2 = SBL__SEAM_PRECISION2;
    return sbl__solver_make(s->atlas->base, &s->solver, s->unknown_count);
}

static sbl_result sbl__seams_solve(void *work, sbl__slice *slice) {
    return sbl__solver_step(&((sbl__seams *)work)->solver, slice);
}

static int sbl__seams_after_apply(void *work) {
    sbl__seams *s = (sbl__seams *)work;
    const int again = s->bound && ++s->rounds < SBL__SEAM_ROUNDS;
    s->bound = 0;
    return again ? SBL__SEAMS_BEFORE : SBL__SEAMS_AFTER;
}

static int sbl__seams_edges(void *work) { return 3 * ((sbl__seams *)work)->atlas->geometry->triangle_count; }
static int sbl__seams_points(void *work) { return ((sbl__seams *)work)->point_count; }
static int sbl__seams_unknowns(void *work) { return ((sbl__seams *)work)->unknown_count; }

/* Does one piece of work. Returns SBL_SUCCESS when the layer is sewn. The layers of a lightmap must be sewn in
   ascending order; they share the points and the solver. */
static sbl_result sbl__seams_step(sbl__seams *s, const sbl__gutters *light, const sbl__atlas *atlas, int layer,
                                  sbl__slice *slice) {
    static const sbl__stage_row table[] = {
        { sbl__seams_make, NULL, sbl__seams_edge, sbl__seams_edges },
        { sbl__seams_make_solver, NULL, sbl__seam_measure, sbl__seams_points },
        { sbl__seams_solve, NULL, NULL, NULL },
        { NULL, sbl__seams_after_apply, sbl__seam_apply, sbl__seams_unknowns },
        { NULL, NULL, sbl__seam_measure, sbl__seams_points }
    };
    s->light = light;
    s->atlas = atlas;
    if (layer != s->layer) {
        s->layer = layer;
        s->rounds = 0;
        s->stages.stage = SBL__SEAMS_BEFORE;
    }
    return sbl__stages_step(&s->stages, table, SBL__COUNT(table), s, slice);
}

/* ======================================================================================================== >>work
   What all front ends have in common. A front end consists of a struct, whose first field is an sbl__work, and of an
   sbl__front_end, whose functions check the descriptor, begin the work and do its stages. These functions get a pointer
   to the struct, which is also a pointer to its sbl__work. >>public lists all front ends in one table. */

/* The functions of a front end. work: its struct. desc: the descriptor that the host gave, which may be NULL */
typedef struct sbl__front_end {
    const char *begin_name;         /* name of the public function that begins the work, for messages */
    int is_map;                     /* 1: the struct begins with an sbl__map, whose channels the host can read */
    /* Checks the descriptor, logs mistakes, and sets *measurement. Changes nothing else. */
    sbl_result (*check)(const sbl__core *core, const void *desc, sbl__measurement *measurement);
    /* Fills the struct, of which only the sbl__work is set so far. desc has been checked. */
    sbl_result (*begin)(void *work, const void *desc);
    const sbl__stage_row *stages;
    int stage_count;
    /* Returns the statistic to which the seconds of the current stage are added, or NULL if there is none. */
    double *(*seconds)(const void *work);
    float (*progress)(const void *work);  /* returns the finished share of the work, 0 to 1, not counting the store */
    void (*free)(void *work);             /* frees all memory and sets the struct to zero */
} sbl__front_end;

/* Work that the host has begun; all zeroes if there is none. */
typedef struct sbl__work {
    const sbl__front_end *front_end;
    sbl__core *core;
    sbl__measurement measurement;
    sbl__stages stages;  /* position in the front end's table of stages */
    sbl__task task;      /* the current job, in front ends whose stages include sbl__work_sense */
    sbl__site *sites;    /* memory for the sites of the task */
    sbl_reading *readings;  /* memory for the task's readings; NULL if the host has provided memory */
    float store_share;   /* share of the progress that filling the store takes; 0 if it need not be filled */
    float progress;      /* progress that the host has been told, 0 to 1; never decreases */
    double progress_at;  /* stats.seconds.total when that was */
} sbl__work;

static int sbl__work_is_done(const sbl__work *w) { return w->stages.stage == w->front_end->stage_count; }

/* Begins work in a struct that is all zeroes. The descriptor has been checked. */
static sbl_result sbl__work_begin(sbl__work *w, const sbl__front_end *front_end, sbl__core *core,
                                  const sbl__measurement *measurement, const void *desc) {
    w->front_end = front_end;
    w->core = core;
    w->measurement = *measurement;
    if (measurement->options.mode == SBL_MODE_GI && !core->scene.store.ready) w->store_share = SBL__BOUNCE_TIME;
    return front_end->begin(w, desc);
}

/* Does one piece of the current stage. SBL_SUCCESS: all stages are done. */
static sbl_result sbl__work_step(sbl__work *w, sbl__slice *slice) {
    const sbl__front_end *f = w->front_end;
    const double start = sbl__now(), bounced = w->core->stats.seconds.bounce;
    double *seconds = f->seconds(w);
    const sbl_result result = sbl__stages_step(&w->stages, f->stages, f->stage_count, w, slice);
    if (seconds) *seconds += sbl__now() - start - (w->core->stats.seconds.bounce - bounced);
    return result;
}

/* >>work: stages that several front ends share */

static sbl_result sbl__work_prepare(void *work, sbl__slice *slice) {
    const sbl__work *w = (const sbl__work *)work;
    return sbl__prepare(w->core, &w->measurement, slice);
}

#define SBL__WORK_SITES 65536  /* maximum number of sites of a job */

/* Sets the task's spec, and allocates its sites and, if `readings` is 1, its readings. count: number of sites of all
   jobs */
static sbl_result sbl__work_make_task(sbl__work *w, double count, int readings) {
    const size_t room = (size_t)SBL__MIN(SBL__WORK_SITES, count);
    sbl__base *base = &w->core->base;
    sbl__spec_make(&w->task.spec, &w->measurement, &w->core->scene, &w->core->desc);
    w->task.sites = w->sites = (sbl__site *)sbl__alloc_raw(base, room, sizeof *w->sites);
    if (readings) w->task.readings = w->readings = (sbl_reading *)sbl__alloc_raw(base, room, sizeof *w->readings);
    return w->sites && (!readings || w->readings) ? SBL_SUCCESS : SBL_ERROR_OUT_OF_MEMORY;
}

static void sbl__work_free_task(sbl__work *w) {
    sbl__free(&w->core->base, w->sites);
    sbl__free(&w->core->base, w->readings);
    w->sites = NULL;
    w->readings = NULL;
}

static int sbl__work_site_count(void *work) { return ((const sbl__work *)work)->task.site_count; }

/* Measures the sites of the task. */
static sbl_result sbl__work_sense(void *work, sbl__slice *slice) {
    sbl__work *w = (sbl__work *)work;
    if (w->stages.at == 0) sbl__job_begin(&w->core->job, &w->core->scene, &w->task);
    w->stages.at = 1;  /* 0: the job has not begun */
    return sbl__core_sense(w->core, slice);
}

/* Returns how many sites of the task are measured. sense: the front end's stage that is sbl__work_sense */
static double sbl__work_measured(const sbl__work *w, int sense) {
    if (w->stages.stage != sense) return w->stages.stage > sense ? w->task.site_count : 0;
    return w->stages.at ? (double)sbl__job_progress(&w->core->job) * w->task.site_count : 0;
}

/* The `seconds` of front ends whose stage 0 is sbl__work_prepare and whose other stages measure. */
static double *sbl__work_seconds(const void *work) {
    const sbl__work *w = (const sbl__work *)work;
    return w->stages.stage ? &w->core->stats.seconds.gather : &w->core->stats.seconds.surface;
}

/* ======================================================================================================== >>map
   A radiance map holds R, and any further layers of light, for a grid of pixels. A front end that makes one (>>picture,
   >>lightmap) has an sbl__map as its first field and a table of stages that begins with SBL__MAP_ROWS. READ and PREVIEW
   are functions of the front end.

   The map is made on the working grid, which is finer than the map that the host reads if texels of a lightmap are
   supersampled: each pixel of the host then consists of across x across working pixels.

       SETUP -> PREPARE -> SURFACE -> READ -> REFINE -> DEVELOP -> the front end's stages
                                              |    ^
                                              PREVIEW, if the host reads channels

   DEVELOP interpolates the pixels between sensors, uploads the layer and filters it. It has a position of its own, so
   that a preview can be made in the middle of any stage.

   Filling the store can take most of the time. If the host reads channels meanwhile, PREPARE pauses for a glimpse: a
   map of direct light alone with few sensors, which goes through the stages until PREVIEW and returns to PREPARE.
   Everything that it has measured is then forgotten, except what the host reads. */

enum { SBL__MAP_SETUP, SBL__MAP_PREPARE, SBL__MAP_SURFACE, SBL__MAP_READ, SBL__MAP_REFINE, SBL__MAP_PREVIEW,
       SBL__MAP_DEVELOP, SBL__MAP_END };

enum { SBL__DEVELOP_FILL, SBL__DEVELOP_SEND, SBL__DEVELOP_FILTER, SBL__DEVELOP_DONE };

enum { SBL__GLIMPSE_NONE, SBL__GLIMPSE_UNDER_WAY, SBL__GLIMPSE_SHOWN };

/* A texture and the target that draws into it. */
typedef struct sbl__map_image { sbl__texture texture; sbl__target target; } sbl__map_image;

/* A layer of light on the GPU. */
typedef struct sbl__map_layer {
    sbl__texture light;         /* interpolated light; alpha of layer 0: noise of R as in sbl__fill.rgba */
    sbl__map_image smooth;      /* filtered light */
} sbl__map_layer;

typedef struct sbl__map {
    sbl__work work;             /* must be first, because pointers to the struct are cast to sbl__work * */
    sbl_picture_desc desc;      /* with defaults; width and height are the size of the working grid */
    int size[2], across;        /* host's size in pixels; each pixel consists of across x across working pixels */
    int *shown;                 /* per pixel of the host: working pixel whose surface it shows; NULL if across is 1 */
    sbl__spec spec;
    uint32_t scene_version;     /* version of the scene that the map shows */
    sbl__camera camera;
    sbl__atlas *atlas;          /* the atlas that a lightmap shows; NULL: a picture shows what the camera sees */
    sbl__surface surface;
    sbl__gbuffer gbuffer;
    sbl__refine refine;
    int layer;                  /* index of the layer that is being developed, or finished by the front end's stages */
    int developed;              /* 1: R is final, because stage DEVELOP has finished layer 0 */
    sbl__stages developing;
    sbl__fill fill;
    sbl__map_layer layers[SBL__LAYERS];
    sbl__pace filter_pace;
    const sbl__target *channels[SBL_CHANNEL_COUNT];  /* target that holds the channel; NULL: refine's pixels hold it */
    sbl__texture copies[SBL_CHANNEL_COUNT];  /* textures of channels, made by sbl__map_send_channel */
    int watched;                /* 1: the host has asked for a channel of the unfinished map, so previews are made */
    int64_t previewed;          /* number of looks when the last preview was made; 0: there is no preview */
    int glimpse;                /* state of the glimpse: SBL__GLIMPSE_NONE and so on */
    sbl__measurement glimpse_measurement;
    sbl_stats glimpse_stats;    /* the statistics when the glimpse began */
    float finished;             /* share of the front end's own stages that is done, 0 to 1 */
    double paced_from[2];       /* seconds spent on sensors, and number of looks, when all sensors last started */
} sbl__map;

#define SBL__READ_PIXELS 32768    /* maximum pixels per transfer between GPU and host, but at least a row of the map */
#define SBL__STORED_NOISE 0.1f    /* assumed relative noise of stored light, for the filter */
#define SBL__PREVIEW_GROWTH 1.25  /* the next preview is made when the number of looks has grown by this factor */
#define SBL__MAP_RAYS 120.0       /* usual time of refinement per pixel, in rays of the store; 38 to 227 measured */
#define SBL__GLIMPSE_TILE 16      /* least width of a tile of the glimpse: the default width of first-level tiles */
#define SBL__GLIMPSE_RAYS 64      /* rays of a sensor of the glimpse */
#define SBL__GLIMPSE_ERROR 0.05f  /* target error of the glimpse, which it rarely reaches */
#define SBL__GLIMPSE_LOOKS 0.01   /* the glimpse ends after the round in which looks per pixel exceed this */

static void sbl__map_image_free(const sbl__device *d, sbl__map_image *image) {
    sbl__target_delete(d, &image->target);
    sbl__texture_delete(d, &image->texture);
}

static void sbl__map_layer_free(const sbl__device *d, sbl__map_layer *l) {
    sbl__texture_delete(d, &l->light);
    sbl__map_image_free(d, &l->smooth);
}

static void sbl__map_free(sbl__map *m) {
    const sbl__device *d = &m->work.core->device;
    int i;
    for (i = 0; i < SBL_CHANNEL_COUNT; i++) sbl__texture_delete(d, &m->copies[i]);
    for (i = 0; i < SBL__LAYERS; i++) sbl__map_layer_free(d, &m->layers[i]);
    sbl__gbuffer_free(d, &m->gbuffer);
    sbl__surface_free(d, &m->surface);
    sbl__refine_free(d, &m->refine);
    sbl__fill_free(d->base, &m->fill);
    sbl__free(d->base, m->shown);
}

/* The last part of a front end's check: sets *measurement, and refuses a working grid that is larger than the driver's
   largest texture. d: with defaults. asked: 1 if the host has set target_error */
static sbl_result sbl__map_check(const sbl__core *c, const char *where, const sbl_picture_desc *d, int asked,
                                 sbl__measurement *measurement) {
    const int most = c->device.gl.capabilities.max_texture_size;
    *measurement = sbl__measurement_of(&d->options, d->sensor_kind, d->sensor_fov);
    measurement->look_rays = sbl__look_rays(d->target_error);
    measurement->looks = asked ? SBL__MAX_LOOKS : SBL__DEFAULT_LOOKS;
    if (d->width <= most && d->height <= most) return SBL_SUCCESS;
    sbl__log(&c->base, SBL_LOG_ERROR, SBL_LOG_ITEM_TOO_LARGE, "%s: size is %d x %d; this driver's textures are at most "
             "%d across", where, d->width, d->height, most);
    return SBL_ERROR_UNSUPPORTED;
}

static void sbl__map_begin_refine(sbl__map *m, sbl__measurement *measurement, const sbl_picture_desc *desc) {
    sbl__refine_begin(&m->refine, m->work.core, measurement, &m->spec, desc, sbl__filter_pixels(desc->filter_radius));
}

/* desc: with defaults. directional: 1: layers 1 to 4 are spherical harmonics */
static void sbl__map_begin(sbl__map *m, const sbl_picture_desc *desc, int across, int directional) {
    sbl__core *c = m->work.core;
    int level;
    m->desc = *desc;
    m->spec.directional = directional;
    m->scene_version = c->scene.version;
    sbl__camera_make(&m->camera, desc, &c->scene.geometry);
    m->size[0] = desc->width / across;
    m->size[1] = desc->height / across;
    m->across = across;
    m->channels[SBL_CHANNEL_RADIANCE] = &m->layers[0].smooth.target;
    m->channels[SBL_CHANNEL_ALBEDO] = &m->gbuffer.target;
    c->stats.picture.width = m->size[0];
    c->stats.picture.height = m->size[1];
    c->stats.picture.target_error = desc->target_error;
    for (level = 0; level < SBL_MAX_LEVELS; level++)
        c->stats.picture.levels[level].tile = SBL__MAX(1, desc->tile >> level);
    sbl__map_begin_refine(m, &m->work.measurement, desc);
    m->work.store_share = 0;  /* sbl__map_progress counts the store */
    m->glimpse_measurement = m->work.measurement;
    m->glimpse_measurement.options.mode = SBL_MODE_DIRECT;
    m->glimpse_measurement.options.rays = SBL__GLIMPSE_RAYS;
}

/* >>map: the glimpse */

/* Returns 1 if a glimpse must be made before the store is filled. */
static int sbl__map_owes_glimpse(const sbl__map *m) {
    return m->watched && m->glimpse == SBL__GLIMPSE_NONE && m->work.measurement.options.mode == SBL_MODE_GI &&
           !m->work.core->scene.store.ready;
}

static void sbl__map_begin_glimpse(sbl__map *m) {
    sbl_picture_desc desc = m->desc;
    m->glimpse = SBL__GLIMPSE_UNDER_WAY;
    m->glimpse_stats = m->work.core->stats;
    desc.tile = SBL__MAX(desc.tile, SBL__GLIMPSE_TILE);
    desc.threshold = 0;
    desc.target_error = SBL__GLIMPSE_ERROR;
    sbl__map_begin_refine(m, &m->glimpse_measurement, &desc);
}

/* Undoes everything that the glimpse has changed, except what the host reads and the time that passed. */
static void sbl__map_end_glimpse(sbl__map *m) {
    sbl__core *c = m->work.core;
    m->glimpse = SBL__GLIMPSE_SHOWN;
    sbl__refine_forget(&m->refine);
    sbl__map_begin_refine(m, &m->work.measurement, &m->desc);
    m->glimpse_stats.seconds = c->stats.seconds;
    c->stats = m->glimpse_stats;
    memset(&c->job.counts, 0, sizeof c->job.counts);
}

/* >>map: what pixels show */

/* Allocates memory and textures, a part of them per piece. Only pictures need a depth buffer. */
static sbl_result sbl__map_setup(void *work, sbl__slice *slice) {
    sbl__map *m = (sbl__map *)work;
    sbl__device *d = &m->work.core->device;
    const int width = m->desc.width, height = m->desc.height;
    sbl_result result;
    (void)slice;
    d->gl.doing = "making the picture's textures";
    switch (m->work.stages.at++) {
        case 0: result = sbl__refine_make(&m->refine); break;
        case 1: result = sbl__surface_make(d, &m->surface, width, height, m->atlas != NULL); break;
        default: return sbl__gbuffer_make(d, &m->gbuffer, width, height, m->atlas ? NULL : &m->surface.depth);
    }
    return result == SBL_SUCCESS ? SBL_UNFINISHED : result;
}

/* Makes a texture with across x across pixels per pixel of the host. */
static sbl_result sbl__map_texture(const sbl__map *m, int across, sbl__texture *t) {
    return sbl__texture_make(&m->work.core->device, t, m->size[0] * across, m->size[1] * across, SBL__GL_RGBA32F);
}

static sbl_result sbl__map_image_make(const sbl__map *m, int across, sbl__map_image *image) {
    const sbl_result result = sbl__map_texture(m, across, &image->texture);
    return result == SBL_SUCCESS ? sbl__target_make(&m->work.core->device, &image->target, &image->texture, 1, NULL)
                                 : result;
}

/* Uploads some of the rows of rgba, from row *at on, and advances *at. SBL_SUCCESS: all rows are uploaded. */
static sbl_result sbl__map_upload(const sbl__map *m, sbl__texture *t, const float *rgba, int *at) {
    const int first = *at, rows = SBL__MIN(SBL__MAX(1, SBL__READ_PIXELS / t->width), t->height - first);
    const float *from = rgba + 4 * (size_t)first * (size_t)t->width;
    const sbl_result result = sbl__texture_write(&m->work.core->device, t, first, rows, from);
    *at += rows;
    return result == SBL_SUCCESS && *at < t->height ? SBL_UNFINISHED : result;
}

/* Prepares what the map needs, or only what the glimpse needs, which is not the store. */
static sbl_result sbl__map_prepare(void *work, sbl__slice *slice) {
    const sbl__map *m = (const sbl__map *)work;
    return sbl__prepare(m->work.core, sbl__map_owes_glimpse(m) ? &m->glimpse_measurement : &m->work.measurement, slice);
}

static int sbl__map_after_prepare(void *work) {
    sbl__map *m = (sbl__map *)work;
    if (sbl__map_owes_glimpse(m)) sbl__map_begin_glimpse(m);
    sbl__refine_update_spec(&m->refine);
    return SBL__MAP_SURFACE;
}

/* Draws surfaces into a G-buffer. offset: position of the sample relative to the pixel's centre, pixels */
static sbl_result sbl__map_draw_surface(sbl__map *m, const sbl__gbuffer *g, const float offset[2], sbl__slice *slice) {
    sbl__core *c = m->work.core;
    sbl__surface_job job;
    job.scene = &c->scene;
    job.camera = &m->camera;
    job.gbuffer = g;
    memcpy(job.offset, offset, sizeof job.offset);
    job.epsilon = m->work.measurement.options.epsilon;
    job.bounced = m->spec.bounced && g == &m->gbuffer;
    job.atlas = m->atlas;
    return sbl__surface_step(&c->device, &m->surface, &job, slice);
}

static sbl_result sbl__map_surface(void *work, sbl__slice *slice) {
    static const float centre[2] = { 0, 0 };
    sbl__map *m = (sbl__map *)work;
    const sbl_result result = sbl__map_draw_surface(m, &m->gbuffer, centre, slice);
    if (result == SBL_SUCCESS && m->atlas) sbl__refine_hide_within(&m->refine, sbl__atlas_texel_size(m->atlas));
    return result;
}

/* Converts a pixel of the G-buffer for refinement. from: position, normal, geometric normal and emission, 4 floats
   each; >>surface describes their fourth components */
static void sbl__map_pixel(const sbl__map *m, const float *const from[4], uint32_t id, sbl__pixel *out) {
    memset(out, 0, sizeof *out);
    memcpy(out->position, from[0], sizeof out->position);
    memcpy(out->normal, from[1], sizeof out->normal);
    memcpy(out->geometric_normal, from[2], sizeof out->geometric_normal);
    out->offset = sbl__spec_offset(&m->spec, &m->work.core->scene, from[0][3]);
    out->id = id;
    if (!m->spec.bounced || !id) return;
    out->sensed = from[1][3] < 0;
    out->stored[0] = out->sensed ? -1 - from[1][3] : from[1][3];
    out->stored[1] = from[2][3];
    out->stored[2] = from[3][3];
    if (!out->sensed) {
        out->uncertainty = SBL__MIN(sbl__leaf_uncertainty(out->stored) * sbl__luminance(out->stored), 1e30f);
        return;
    }
    memcpy(out->radiance, out->stored, sizeof out->radiance);
    out->variance = (double)(SBL__STORED_NOISE * sbl__max3(out->stored));
    out->variance *= out->variance;
}

/* Returns the number of the working pixel whose surface pixel i of the host shows. */
static size_t sbl__map_shown(const sbl__map *m, size_t i) { return m->shown ? (size_t)m->shown[i] : i; }

/* Reads rows of the G-buffer back, from row stages.at on, and advances stages.at. SBL_SUCCESS: all rows are read. */
static sbl_result sbl__map_read(void *work, sbl__slice *slice) {
    static const int attachments[4] = { SBL__GBUFFER_POSITION, SBL__GBUFFER_NORMAL, SBL__GBUFFER_GEOMETRIC_NORMAL,
                                        SBL__GBUFFER_EMISSION };
    sbl__map *m = (sbl__map *)work;
    sbl__core *c = m->work.core;
    const int parts = m->spec.bounced ? 4 : 3;  /* 4: also emission, whose alpha is the blue component of stored R */
    const int width = m->desc.width, most = SBL__MAX(1, SBL__READ_PIXELS / width / m->across) * m->across;
    const int first = m->work.stages.at, rows = SBL__MIN(most, m->desc.height - first), count = rows * width;
    const sbl__target *t = &m->gbuffer.target;
    float *data = (float *)sbl__alloc_raw(&c->base, (size_t)count, 4 * 16 + 4);
    float *ids = data ? data + 16 * (size_t)count : NULL;
    sbl_result result = data ? SBL_SUCCESS : SBL_ERROR_OUT_OF_MEMORY;
    int i, k;
    (void)slice;
    c->device.gl.doing = "reading the G-buffer";
    for (k = 0; k < parts && result == SBL_SUCCESS; k++)
        result = sbl__target_read(&c->device, t, attachments[k], first, rows, data + 4 * (size_t)count * (size_t)k);
    if (result == SBL_SUCCESS) result = sbl__target_read(&c->device, t, SBL__GBUFFER_ID, first, rows, ids);
    c->stats.sensors.readbacks += parts + 1;
    for (i = 0; i < count && result == SBL_SUCCESS; i++) {
        const float *from[4];
        sbl__pixel pixel;
        uint32_t id;
        memcpy(&id, ids + i, sizeof id);
        for (k = 0; k < 4; k++) from[k] = data + 4 * ((size_t)count * (size_t)k + (size_t)i);
        sbl__map_pixel(m, from, id, &pixel);
        sbl__refine_put(&m->refine, (size_t)first * (size_t)width + (size_t)i, &pixel);
        c->stats.picture.visible_pixels += id != 0;
    }
    sbl__free(&c->base, data);
    m->work.stages.at += rows;
    return result == SBL_SUCCESS && m->work.stages.at < m->desc.height ? SBL_UNFINISHED : result;
}

static int sbl__map_after_read(void *work) {
    const sbl__map *m = (const sbl__map *)work;
    const sbl__core *c = m->work.core;
    if (!c->stats.picture.visible_pixels && m->glimpse != SBL__GLIMPSE_UNDER_WAY)
        sbl__log(&c->base, SBL_LOG_WARNING, SBL_LOG_ITEM_NOTHING_VISIBLE, "%s", m->atlas ?
                 "no mesh of the lightmap has a triangle on the map; check lightmap_texcoords" :
                 "the camera sees no surface; check world_to_view, view_to_clip and the scene's bounds");
    return SBL__MAP_REFINE;
}

/* >>map: developing */

/* Makes sbl__map_develop begin with a layer. */
static void sbl__map_develop_from(sbl__map *m, int layer) {
    sbl__fill_free(&m->work.core->base, &m->fill);
    m->layer = layer;
    m->developing.stage = SBL__DEVELOP_FILL;
    m->developing.at = 0;
}

static sbl_result sbl__map_fill(void *work, sbl__slice *slice) {
    sbl__map *m = (sbl__map *)work;
    m->fill.refine = &m->refine;
    m->fill.layer = m->layer;
    return sbl__fill_step(&m->fill, slice);
}

static sbl_result sbl__map_send(void *work, sbl__slice *slice) {
    sbl__map *m = (sbl__map *)work;
    sbl__device *d = &m->work.core->device;
    sbl__texture *t = &m->layers[m->layer].light;
    sbl_result result;
    (void)slice;
    d->gl.doing = "uploading the radiance map";
    result = sbl__map_texture(m, m->across, t);
    if (result == SBL_SUCCESS) result = sbl__map_upload(m, t, m->fill.rgba, &m->developing.at);
    if (result == SBL_SUCCESS) sbl__fill_free(d->base, &m->fill);
    return result;
}

static sbl_result sbl__map_filter(void *work, sbl__slice *slice) {
    sbl__map *m = (sbl__map *)work;
    sbl__device *d = &m->work.core->device;
    sbl__map_layer *layer = &m->layers[m->layer];
    sbl__filter filter;
    int rows[2];
    sbl_result result = SBL_SUCCESS;
    d->gl.doing = "filtering";
    rows[0] = m->developing.at;
    if (rows[0] == 0) result = sbl__map_image_make(m, m->across, &layer->smooth);
    if (result != SBL_SUCCESS) return result;
    filter.radius = SBL__MAX(m->desc.filter_radius, 0);
    filter.geometry_aware = m->desc.options.mode != SBL_MODE_PAPER;
    filter.radiance = &m->layers[0].light;
    filter.layer = m->layer ? &layer->light : NULL;
    filter.layer_noise = sbl__spec_layer_noise(&m->spec);
    rows[1] = sbl__pace_rows(&m->filter_pace, slice, &layer->smooth.target, rows[0]);
    result = sbl__filter_draw(d, &filter, &m->gbuffer, &layer->smooth.target, rows);
    if (result == SBL_SUCCESS) result = sbl__pace_end(d, &m->filter_pace, (double)rows[1] * m->desc.width);
    m->developing.at += rows[1];
    return result == SBL_SUCCESS && m->developing.at < m->desc.height ? SBL_UNFINISHED : result;
}

/* Interpolates, uploads and filters m->layer, piece by piece. */
static sbl_result sbl__map_develop(void *work, sbl__slice *slice) {
    static const sbl__stage_row table[] = {
        { sbl__map_fill, NULL, NULL, NULL },
        { sbl__map_send, NULL, NULL, NULL },
        { sbl__map_filter, NULL, NULL, NULL }
    };
    return sbl__stages_step(&((sbl__map *)work)->developing, table, SBL__COUNT(table), work, slice);
}

static int sbl__map_after_develop(void *work) {
    ((sbl__map *)work)->developed = 1;
    return SBL__MAP_END;
}

/* >>map: refining */

static int sbl__map_preview_is_due(const sbl__map *m) {
    const double looks = (double)sbl__refine_looks(&m->refine);
    const double pixels = (double)m->work.core->stats.picture.visible_pixels * m->across * m->across;
    return m->watched && sbl__refine_round_is_over(&m->refine) && looks > 0 &&
           looks >= (m->glimpse == SBL__GLIMPSE_UNDER_WAY ? SBL__GLIMPSE_LOOKS * pixels
                                                          : SBL__PREVIEW_GROWTH * (double)m->previewed);
}

static sbl_result sbl__map_refine(void *work, sbl__slice *slice) {
    sbl__map *m = (sbl__map *)work;
    sbl_result result;
    if (sbl__refine_is_at_start(&m->refine)) {
        m->paced_from[0] = m->work.core->stats.seconds.gather + m->work.core->stats.seconds.refine;
        m->paced_from[1] = (double)sbl__refine_looks(&m->refine);
    }
    result = sbl__refine_step(&m->refine, slice);
    return result == SBL_UNFINISHED && sbl__map_preview_is_due(m) ? SBL_SUCCESS : result;
}

static int sbl__map_after_refine(void *work) {
    sbl__map *m = (sbl__map *)work;
    sbl__map_develop_from(m, 0);
    return m->glimpse == SBL__GLIMPSE_UNDER_WAY || sbl__map_preview_is_due(m) ? SBL__MAP_PREVIEW : SBL__MAP_DEVELOP;
}

static int sbl__map_after_preview(void *work) {
    sbl__map *m = (sbl__map *)work;
    if (m->glimpse == SBL__GLIMPSE_UNDER_WAY) {
        sbl__map_end_glimpse(m);
        return SBL__MAP_PREPARE;
    }
    m->previewed = sbl__refine_looks(&m->refine);
    return SBL__MAP_REFINE;
}

/* >>map: stages */

/* The first rows of the table of stages of a front end, which supplies the functions `read` and `preview`. */
#define SBL__MAP_ROWS(read, preview) \
    { sbl__map_setup, NULL, NULL, NULL }, { sbl__map_prepare, sbl__map_after_prepare, NULL, NULL }, \
    { sbl__map_surface, NULL, NULL, NULL }, { read, sbl__map_after_read, NULL, NULL }, \
    { sbl__map_refine, sbl__map_after_refine, NULL, NULL }, { preview, sbl__map_after_preview, NULL, NULL }, \
    { sbl__map_develop, sbl__map_after_develop, NULL, NULL }

static double *sbl__map_seconds(const void *work) {
    const sbl__map *m = (const sbl__map *)work;
    sbl_stats *stats = &m->work.core->stats;
    const int stage = m->work.stages.stage, develops = stage == SBL__MAP_PREVIEW || stage == SBL__MAP_DEVELOP;
    return stage <= SBL__MAP_READ ? &stats->seconds.surface
         : stage == SBL__MAP_REFINE && sbl__refine_is_sensing(&m->refine) ? &stats->seconds.gather
         : stage >= SBL__MAP_END || (develops && m->developing.stage == SBL__DEVELOP_DONE) ? &stats->seconds.resolve
         : develops && m->developing.stage == SBL__DEVELOP_FILTER ? &stats->seconds.filter : &stats->seconds.refine;
}

/* Foresees the seconds until refinement ends, from its pace so far. Before errors are known the pace says little, so
   the speed of the rays of the store counts as well. */
static double sbl__map_seconds_left(const sbl__map *m) {
    const sbl__core *c = m->work.core;
    const sbl_stats *stats = &c->stats;
    const double looks = sbl__refine_looks_now(&m->refine), taken = looks - m->paced_from[1];
    const double pixels = (double)m->desc.width * m->desc.height, rays = (double)stats->store.rays;
    const double stored = (double)sbl__bounce_progress(c), bounce = stats->seconds.bounce;
    double filling = 0, refining = 0;
    if (rays > 0)
        refining = SBL__MAP_RAYS * pixels * bounce * SBL__MIN(1, SBL__BOUNCE_CAST / SBL__MAX(stored, 1e-6)) / rays;
    if (bounce > 0) filling = bounce * (1 / SBL__MAX(stored, 1e-6) - 1);
    if (m->work.stages.stage >= SBL__MAP_REFINE && taken > 0) {
        const double pace = (stats->seconds.gather + stats->seconds.refine - m->paced_from[0]) / taken;
        const double foreseen = pace * (sbl__refine_looks_expected(&m->refine) - looks);
        refining = sbl__refine_error(&m->refine) < 0 ? SBL__MAX(refining, foreseen) : foreseen;
    } else if (!(refining > 0)) refining = 1e9;  /* nothing is known yet */
    return filling + refining;
}

/* Returns the share of time that has passed if the rest takes as long as foreseen. Since progress cannot go back, a
   short mistake must not raise it: in twice the time it grows at most to eight times its value. */
static float sbl__map_progress(const void *work) {
    const sbl__map *m = (const sbl__map *)work;
    const double seconds = m->work.core->stats.seconds.total, before = SBL__MAX(m->work.progress_at, 1e-9);
    double share, most;
    if (sbl__work_is_done(&m->work)) return 1;
    if (m->developed) return 0.96f + 0.03f * m->finished;
    if (m->work.stages.stage == SBL__MAP_DEVELOP) return 0.95f;
    if (m->glimpse == SBL__GLIMPSE_UNDER_WAY) return 0;
    share = 0.95 * seconds / (seconds + sbl__map_seconds_left(m) + 1e-9);
    most = SBL__MAX((double)m->work.progress, 0.01) * pow(seconds / before, 3);
    return (float)SBL__MIN(share, most);
}

/* Called when the host asks for a channel of an unfinished map. Makes a preview at once if the map has sensors, but no
   preview yet; otherwise the stage PREVIEW makes the next one. Returns SBL_UNFINISHED if there is nothing to show. */
static sbl_result sbl__map_watch(sbl__map *m) {
    sbl__slice slice = sbl__slice_of(&m->work.core->desc, 0);
    const int stage = m->work.stages.stage;
    sbl_result result;
    m->watched = 1;
    if (m->previewed || m->glimpse == SBL__GLIMPSE_SHOWN) return SBL_SUCCESS;
    if (m->glimpse == SBL__GLIMPSE_UNDER_WAY || sbl__refine_error(&m->refine) < 0) return SBL_UNFINISHED;
    if (!m->developed && stage != SBL__MAP_PREVIEW && stage != SBL__MAP_DEVELOP) sbl__map_develop_from(m, 0);
    do result = m->work.front_end->stages[SBL__MAP_PREVIEW].piece(m, &slice);
    while (result == SBL_UNFINISHED);
    if (result == SBL_SUCCESS) m->previewed = sbl__refine_looks(&m->refine);
    return result;
}

/* Develops R from the sensors measured so far. Does nothing if R is final. */
static sbl_result sbl__map_preview(void *work, sbl__slice *slice) {
    return ((sbl__map *)work)->developed ? SBL_SUCCESS : sbl__map_develop(work, slice);
}

/* >>map: channels */

/* Per channel: number of floats per pixel; index of its texture among those of sbl__map.channels, if this is not NULL;
   index of its texture in the G-buffer, or -1 if the G-buffer does not have it. */
static const struct { int components, attachment, gbuffer; } sbl__channels[SBL_CHANNEL_COUNT] = {
    { 3, 0, -1 }, { 3, 0, -1 }, { 3, SBL__GBUFFER_ALBEDO, -1 }, { 3, 0, SBL__GBUFFER_NORMAL },
    { 3, 0, SBL__GBUFFER_POSITION }, { 1, 0, SBL__GBUFFER_ID }, { 1, 0, -1 }, { 1, 0, -1 }, { 3, 0, -1 }, { 1, 0, -1 },
    { 1, 0, -1 }, { 3, 0, -1 }, { 3, 0, -1 }, { 3, 0, -1 }, { 3, 0, -1 }, { 3, 1, -1 }
};

/* Gets a pixel of a channel that no target holds. place: number of the pixel of the host */
static void sbl__map_channel_pixel(const sbl__map *m, sbl_channel channel, size_t place, float *out) {
    const size_t i = sbl__map_shown(m, place);
    const sbl__pixel *pixel = sbl__refine_pixel(&m->refine, i);
    double depth = 0;
    int k;
    for (k = 0; k < 3 && !m->atlas; k++)
        depth -= m->camera.back[k] * ((double)pixel->position[k] - m->camera.eye[k]);
    if (channel == SBL_CHANNEL_OVERLAP) out[0] = m->atlas ? sbl__atlas_others(m->atlas, i) : 0;
    else if (!pixel->id || channel >= SBL_CHANNEL_SH_0)
        memset(out, 0, (size_t)sbl__channels[channel].components * sizeof *out);
    else if (channel == SBL_CHANNEL_NORMAL) memcpy(out, pixel->normal, sizeof pixel->normal);
    else if (channel == SBL_CHANNEL_POSITION) memcpy(out, pixel->position, sizeof pixel->position);
    else if (channel == SBL_CHANNEL_STORE) memcpy(out, pixel->stored, sizeof pixel->stored);
    else out[0] = channel == SBL_CHANNEL_ID ? (float)pixel->id
                : channel == SBL_CHANNEL_DEPTH ? (float)depth
                : channel == SBL_CHANNEL_ERROR ? pixel->error : (float)pixel->level;
}

/* Copies a channel that a target holds into the host's array, three floats per pixel. */
static sbl_result sbl__map_copy_channel(sbl__map *m, sbl_channel channel, float *out) {
    sbl__core *c = m->work.core;
    const sbl__target *t = m->channels[channel];
    const size_t width = (size_t)t->width;
    const int *shown = t->width == m->size[0] ? NULL : m->shown;
    const int across = shown ? m->across : 1, most = SBL__MAX(1, SBL__READ_PIXELS / t->width / across) * across;
    float *data = (float *)sbl__alloc_raw(&c->base, width * (size_t)most, 16);
    sbl_result result = data ? SBL_SUCCESS : SBL_ERROR_OUT_OF_MEMORY;
    size_t i;
    int row;
    c->device.gl.doing = "reading a channel";
    for (row = 0; row < t->height && result == SBL_SUCCESS; row += most) {
        const int rows = SBL__MIN(most, t->height - row);
        const size_t first = width * (size_t)row, from = first / (size_t)(across * across);
        result = sbl__target_read(&c->device, t, sbl__channels[channel].attachment, row, rows, data);
        for (i = 0; i < width * (size_t)rows / (size_t)(across * across) && result == SBL_SUCCESS; i++)
            memcpy(out + 3 * (from + i), data + 4 * (shown ? (size_t)shown[from + i] - first : i), 3 * sizeof(float));
    }
    sbl__free(&c->base, data);
    return result;
}

static sbl_result sbl__map_read_channel(sbl__map *m, sbl_channel channel, float *out) {
    const size_t pixels = (size_t)m->size[0] * (size_t)m->size[1];
    size_t i;
    if (m->channels[channel]) return sbl__map_copy_channel(m, channel, out);
    for (i = 0; i < pixels; i++)
        sbl__map_channel_pixel(m, channel, i, out + i * (size_t)sbl__channels[channel].components);
    return SBL_SUCCESS;
}

/* Copies a channel into a texture of the size that the host reads. Returns its GL name, or 0 on failure. */
static uint32_t sbl__map_send_channel(sbl__map *m, sbl_channel channel) {
    sbl__core *c = m->work.core;
    const size_t pixels = (size_t)m->size[0] * (size_t)m->size[1];
    sbl__texture *t = &m->copies[channel];
    const int rgb = sbl__channels[channel].components == 3;
    const unsigned format = channel == SBL_CHANNEL_ID ? SBL__GL_R32UI : rgb ? SBL__GL_RGBA32F : SBL__GL_R32F;
    float *data = (float *)sbl__alloc(&c->base, pixels, (rgb ? 4 : 1) * sizeof(float));
    sbl_result result;
    size_t i;
    if (!data) return 0;
    result = sbl__map_read_channel(m, channel, data);
    for (i = pixels; i-- > 0 && rgb;) {  /* backwards, because three floats per pixel become four in place */
        memmove(data + 4 * i, data + 3 * i, 3 * sizeof(float));
        data[4 * i + 3] = 0;
    }
    for (i = 0; i < pixels && channel == SBL_CHANNEL_ID; i++)
        memcpy(data + i, &sbl__refine_pixel(&m->refine, sbl__map_shown(m, i))->id, 4);
    c->device.gl.doing = "making a channel's texture";
    if (result == SBL_SUCCESS) result = sbl__texture_make(&c->device, t, m->size[0], m->size[1], format);
    if (result == SBL_SUCCESS) result = sbl__texture_write(&c->device, t, 0, m->size[1], data);
    sbl__free(&c->base, data);
    return result == SBL_SUCCESS ? t->id : 0;
}

/* Returns the GL name of a channel's texture, or 0 on failure. */
static uint32_t sbl__map_channel_texture(sbl__map *m, sbl_channel channel) {
    const sbl__target *target = m->channels[channel];
    const int gbuffer = sbl__channels[channel].gbuffer;
    if (m->shown && (!target || target->width != m->size[0])) return sbl__map_send_channel(m, channel);
    if (gbuffer >= 0) return m->gbuffer.textures[gbuffer].id;
    return target ? target->textures[sbl__channels[channel].attachment] : sbl__map_send_channel(m, channel);
}

/* ======================================================================================================== >>picture
   The front end that makes pictures: a radiance map of what a camera sees, then composition and anti-aliasing. */

enum { SBL__PICTURE_FINISH = SBL__MAP_END, SBL__PICTURE_SAMPLE, SBL__PICTURE_RESOLVE, SBL__PICTURE_DONE };

/* A composition: radiance, and what a screen shows if there is a tone. */
typedef struct sbl__composition { sbl__texture textures[2]; sbl__target target; } sbl__composition;

/* Passes of a preview. The second and the third are needed for auto_exposure only. */
enum { SBL__PREVIEW_COMPOSE, SBL__PREVIEW_METER, SBL__PREVIEW_EXPOSE };

#define SBL__METER_BINS 1024   /* histograms of the logarithm of luminance, from 2^-64 on */
#define SBL__METER_STEP 0.125  /* width of a bin in stops */
#define SBL__METER_ASIDE 0.05  /* share of the darkest and of the brightest pixels that do not count */
#define SBL__METER_LIGHT -0.5  /* stops: the mean R is shown like a white surface of this radiance */
#define SBL__METER_BRIGHT 0.05 /* share of the pixels, the brightest ones, that are highlights */
#define SBL__METER_HIGHLIGHT 1.5  /* stops: greatest radiance that the mean highlight is shown as */
#define SBL__METER_YIELD 1.5   /* stops by which highlights may lower the exposure */

typedef struct sbl__picture {
    sbl__map map;               /* must be first, because pointers to the struct are cast to sbl__map * */
    sbl__gbuffer sample;        /* G-buffer of the current anti-aliasing sample; not made if desc.samples is 1 */
    sbl__composition sums[2];   /* sum over an even, and over an odd number of anti-aliasing samples */
    sbl__composition preview;
    sbl__pace resolve_pace;
    int resolved;               /* number of finished anti-aliasing samples */
    int pass, row;              /* the current preview: its pass, and the number of finished rows of the pass */
    int meter[2][SBL__METER_BINS];  /* numbers of pixels: by R where there is a surface, and by FINAL */
} sbl__picture;

static void sbl__composition_free(const sbl__device *d, sbl__composition *s) {
    sbl__target_delete(d, &s->target);
    sbl__texture_delete(d, &s->textures[0]);
    sbl__texture_delete(d, &s->textures[1]);
}

static sbl_result sbl__composition_make(const sbl__map *m, sbl__composition *s) {
    const int count = m->desc.tone != SBL_TONE_NONE ? 2 : 1;
    sbl_result result = SBL_SUCCESS;
    int i;
    for (i = 0; i < count && result == SBL_SUCCESS; i++) result = sbl__map_texture(m, 1, &s->textures[i]);
    return result == SBL_SUCCESS ? sbl__target_make(&m->work.core->device, &s->target, s->textures, count, NULL)
                                 : result;
}

static void sbl__picture_free(void *work) {
    sbl__picture *p = (sbl__picture *)work;
    const sbl__device *d = &p->map.work.core->device;
    int i;
    for (i = 0; i < 2; i++) sbl__composition_free(d, &p->sums[i]);
    sbl__composition_free(d, &p->preview);
    sbl__gbuffer_free(d, &p->sample);
    sbl__map_free(&p->map);
    memset(p, 0, sizeof *p);
}

/* Returns the descriptor with defaults. Without world_to_view, the camera frames the scene. */
static sbl_picture_desc sbl__picture_desc_of(const sbl__core *c, const sbl_picture_desc *desc) {
    sbl_picture_desc d = sbl_picture_desc_defaults(desc);
    if (sbl__all_zero(d.world_to_view, 16)) sbl__camera_frame(&c->scene.geometry, &d);
    return d;
}

static sbl_result sbl__picture_check(const sbl__core *c, const void *desc, sbl__measurement *measurement) {
    const sbl_picture_desc *given = (const sbl_picture_desc *)desc, d = sbl__picture_desc_of(c, given);
    const sbl_result result = sbl__check_picture(&c->base, &d, c->scene.draw != NULL);
    if (result != SBL_SUCCESS) return result;
    return sbl__map_check(c, "sbl_picture_desc", &d, given && given->target_error > 0, measurement);
}

/* Makes a composition the one that the host reads. */
static void sbl__picture_show(sbl__picture *p, const sbl__composition *s) {
    p->map.channels[SBL_CHANNEL_FINAL] = &s->target;
    p->map.channels[SBL_CHANNEL_DISPLAY] = p->map.desc.tone != SBL_TONE_NONE ? &s->target : NULL;
}

static sbl_result sbl__picture_begin(void *work, const void *desc) {
    sbl__picture *p = (sbl__picture *)work;
    const sbl_picture_desc d = sbl__picture_desc_of(p->map.work.core, (const sbl_picture_desc *)desc);
    sbl__map_begin(&p->map, &d, 1, 0);
    p->map.work.core->stats.picture.exposure = d.exposure;
    sbl__picture_show(p, &p->preview);
    return SBL_SUCCESS;
}

/* >>picture: composition */

/* Composes anti-aliasing sample `index` of `count`, and draws rows of the sum of samples 0 to `index`, from *row on.
   Advances *row. SBL_SUCCESS: all rows are drawn. */
static sbl_result sbl__picture_compose(sbl__picture *p, int index, int count, const sbl__target *out, int *row,
                                       const sbl__slice *slice) {
    const sbl__map *m = &p->map;
    sbl__device *d = &m->work.core->device;
    sbl__resolve r;
    int rows[2];
    sbl_result result;
    d->gl.doing = "composing the picture";
    r.centres = &m->gbuffer;
    r.sample = count > 1 ? &p->sample : &m->gbuffer;
    r.radiance = &m->layers[0].smooth.texture;
    r.previous = p->sums[index & 1].textures;  /* sample 0 does not read it */
    r.tone = m->desc.tone;
    r.stops = m->work.core->stats.picture.exposure;
    r.environment = &m->work.core->scene.environment;
    r.camera = &m->camera;
    r.index = index;
    r.count = count;
    rows[0] = *row;
    rows[1] = sbl__pace_rows(&p->resolve_pace, slice, out, *row);
    result = sbl__resolve_draw(d, &r, out, rows);
    if (result == SBL_SUCCESS) result = sbl__pace_end(d, &p->resolve_pace, (double)rows[1] * m->desc.width);
    *row += rows[1];
    return result == SBL_SUCCESS && *row < m->desc.height ? SBL_UNFINISHED : result;
}

/* Counts a pixel in a histogram, unless it is black. */
static void sbl__meter_count(int bins[SBL__METER_BINS], const float rgb[3]) {
    const double luminance = (double)sbl__luminance(rgb);
    const int bin = luminance > 0 ? (int)((log2(luminance) + 64) / SBL__METER_STEP) : -1;
    if (luminance > 0) bins[SBL__MIN(SBL__MAX(bin, 0), SBL__METER_BINS - 1)]++;
}

/* Returns the mean binary logarithm of the luminances between two shares of the pixels, counted from the darkest.
   Returns -DBL_MAX if no pixel was counted. */
static double sbl__meter_mean(const int bins[SBL__METER_BINS], double from, double to) {
    double all = 0, below = 0, sum = 0, weight = 0;
    int i;
    for (i = 0; i < SBL__METER_BINS; i++) all += bins[i];
    for (i = 0; i < SBL__METER_BINS; below += bins[i++]) {
        const double part = SBL__MIN(below + bins[i], to * all) - SBL__MAX(below, from * all);
        if (part <= 0) continue;
        sum += part * ((i + 0.5) * SBL__METER_STEP - 64);
        weight += part;
    }
    return weight > 0 ? sum / weight : -DBL_MAX;
}

/* Chooses the exposure. As a light meter held into the scene does, it goes by the light that arrives and not by how
   bright the surfaces are, so that white rooms stay white and dark ones dark. The light is the mean logarithm of R,
   without the darkest and the brightest SBL__METER_ASIDE of the pixels; if no surface is lit, it is that of FINAL.
   Highlights limit the exposure. */
static float sbl__meter_stops(int meter[2][SBL__METER_BINS]) {
    const double lit = sbl__meter_mean(meter[0], SBL__METER_ASIDE, 1 - SBL__METER_ASIDE);
    const double light = lit > -DBL_MAX ? lit : sbl__meter_mean(meter[1], SBL__METER_ASIDE, 1 - SBL__METER_ASIDE);
    const double brightest = sbl__meter_mean(meter[1], 1 - SBL__METER_BRIGHT, 1);
    const double stops = SBL__METER_LIGHT - light, limit = SBL__METER_HIGHLIGHT - brightest;
    return light > -DBL_MAX ? (float)SBL__MAX(SBL__MIN(stops, limit), stops - SBL__METER_YIELD) : 0;
}

/* Counts rows of the preview in the histograms, from p->row on. */
static sbl_result sbl__picture_meter(sbl__picture *p) {
    sbl__map *m = &p->map;
    sbl__core *c = m->work.core;
    const size_t width = (size_t)m->desc.width;
    const int first = p->row, rows = SBL__MIN(SBL__MAX(1, SBL__READ_PIXELS / m->desc.width), m->desc.height - first);
    const sbl__target *const targets[2] = { &m->layers[0].smooth.target, &p->preview.target };
    float *data = (float *)sbl__alloc_raw(&c->base, width * (size_t)rows, 16);
    sbl_result result = data ? SBL_SUCCESS : SBL_ERROR_OUT_OF_MEMORY;
    size_t i;
    int k;
    c->device.gl.doing = "measuring the exposure";
    if (first == 0) memset(p->meter, 0, sizeof p->meter);
    for (k = 0; k < 2 && result == SBL_SUCCESS; k++) {
        result = sbl__target_read(&c->device, targets[k], 0, first, rows, data);
        for (i = 0; i < width * (size_t)rows && result == SBL_SUCCESS; i++)
            sbl__meter_count(p->meter[k], data + 4 * i);
    }
    sbl__free(&c->base, data);
    p->row += rows;
    if (result == SBL_SUCCESS && p->row < m->desc.height) return SBL_UNFINISHED;
    if (result == SBL_SUCCESS) c->stats.picture.exposure = m->desc.exposure + sbl__meter_stops(p->meter);
    return result;
}

/* Composes the preview from one sample per pixel, at its centre, and from R as developed last. With auto_exposure it
   then chooses the exposure, and composes the preview again. */
static sbl_result sbl__picture_compose_preview(sbl__picture *p, const sbl__slice *slice) {
    const int last = p->map.desc.auto_exposure ? SBL__PREVIEW_EXPOSE : SBL__PREVIEW_COMPOSE;
    sbl_result result = SBL_SUCCESS;
    if (p->pass == SBL__PREVIEW_COMPOSE && p->row == 0) result = sbl__composition_make(&p->map, &p->preview);
    if (result == SBL_SUCCESS)
        result = p->pass == SBL__PREVIEW_METER ? sbl__picture_meter(p)
               : sbl__picture_compose(p, 0, 1, &p->preview.target, &p->row, slice);
    if (result != SBL_SUCCESS) return result;
    p->row = 0;
    p->pass = p->pass < last ? p->pass + 1 : SBL__PREVIEW_COMPOSE;
    return p->pass != SBL__PREVIEW_COMPOSE ? SBL_UNFINISHED : SBL_SUCCESS;
}

static sbl_result sbl__picture_preview(void *work, sbl__slice *slice) {
    const sbl_result result = sbl__map_preview(work, slice);
    return result == SBL_SUCCESS ? sbl__picture_compose_preview((sbl__picture *)work, slice) : result;
}

/* Makes the textures of the last stages. Then it makes a preview with the final R, if the host reads channels or the
   exposure is to be measured. */
static sbl_result sbl__picture_finish(void *work, sbl__slice *slice) {
    sbl__picture *p = (sbl__picture *)work;
    sbl__map *m = &p->map;
    sbl__device *d = &m->work.core->device;
    sbl_result result = SBL_SUCCESS;
    int i;
    if (m->work.stages.at++)
        return m->watched || m->desc.auto_exposure ? sbl__picture_compose_preview(p, slice) : SBL_SUCCESS;
    d->gl.doing = "making the picture's textures";
    for (i = 0; i < 2 && result == SBL_SUCCESS; i++) result = sbl__composition_make(m, &p->sums[i]);
    if (result == SBL_SUCCESS && m->desc.samples > 1)
        result = sbl__gbuffer_make(d, &p->sample, m->desc.width, m->desc.height, &m->surface.depth);
    return result == SBL_SUCCESS ? SBL_UNFINISHED : result;
}

static sbl_result sbl__picture_sample(void *work, sbl__slice *slice) {
    sbl__picture *p = (sbl__picture *)work;
    float offset[2];
    sbl__sample_offset(p->resolved, p->map.desc.samples, offset);
    return p->map.desc.samples > 1 ? sbl__map_draw_surface(&p->map, &p->sample, offset, slice) : SBL_SUCCESS;
}

static sbl_result sbl__picture_resolve(void *work, sbl__slice *slice) {
    sbl__picture *p = (sbl__picture *)work;
    return sbl__picture_compose(p, p->resolved, p->map.desc.samples, &p->sums[1 - (p->resolved & 1)].target,
                                &p->map.work.stages.at, slice);
}

static int sbl__picture_after_resolve(void *work) {
    sbl__picture *p = (sbl__picture *)work;
    p->map.finished = (float)++p->resolved / (float)p->map.desc.samples;
    if (p->resolved < p->map.desc.samples) return SBL__PICTURE_SAMPLE;
    sbl__picture_show(p, &p->sums[p->resolved & 1]);
    return SBL__PICTURE_DONE;
}

static const sbl__stage_row sbl__picture_stages[] = {
    SBL__MAP_ROWS(sbl__map_read, sbl__picture_preview),
    { sbl__picture_finish, NULL, NULL, NULL },
    { sbl__picture_sample, NULL, NULL, NULL },
    { sbl__picture_resolve, sbl__picture_after_resolve, NULL, NULL }
};
static const sbl__front_end sbl__picture_front_end = {
    "sbl_begin_picture", 1, sbl__picture_check, sbl__picture_begin, sbl__picture_stages, SBL__PICTURE_DONE,
    sbl__map_seconds, sbl__map_progress, sbl__picture_free
};

/* ======================================================================================================== >>lightmap
   The front end that bakes lightmaps: a radiance map of what an atlas shows, then for each layer of light the mean over
   supersampled texels, gutters and seams. */

enum { SBL__LIGHTMAP_LIGHT = SBL__MAP_END, SBL__LIGHTMAP_GUTTERS, SBL__LIGHTMAP_SEAMS, SBL__LIGHTMAP_SEND,
       SBL__LIGHTMAP_DONE };

typedef struct sbl__lightmap {
    sbl__map map;               /* must be first, because pointers to the struct are cast to sbl__map * */
    sbl__atlas atlas;
    int gutter, sew;            /* width of gutters, texels; 1: seams are sewn, if gutter is above 0 */
    sbl__gutters gutters;
    sbl__seams seams;
    sbl__map_image finals[SBL__LAYERS];  /* layers with gutters and sewn seams */
    sbl__map_image mean;        /* if supersample is above 1: per texel, mean R of its working pixels; no gutters */
} sbl__lightmap;

static void sbl__lightmap_free(void *work) {
    sbl__lightmap *l = (sbl__lightmap *)work;
    const sbl__device *d = &l->map.work.core->device;
    int i;
    for (i = 0; i < SBL__LAYERS; i++) sbl__map_image_free(d, &l->finals[i]);
    sbl__map_image_free(d, &l->mean);
    sbl__atlas_free(d->base, &l->atlas);
    sbl__gutters_free(d->base, &l->gutters);
    sbl__seams_free(d->base, &l->seams);
    sbl__map_free(&l->map);
    memset(l, 0, sizeof *l);
}

static sbl_result sbl__lightmap_check(const sbl__core *c, const void *desc, sbl__measurement *measurement) {
    const sbl_lightmap_desc *given = (const sbl_lightmap_desc *)desc, d = sbl_lightmap_desc_defaults(given);
    const sbl_picture_desc picture = sbl__lightmap_picture(&d);
    const sbl_result result = sbl__check_lightmap(&c->base, &d, &c->scene);
    if (result != SBL_SUCCESS) return result;
    return sbl__map_check(c, "sbl_lightmap_desc", &picture, given && given->target_error > 0, measurement);
}

static sbl_result sbl__lightmap_begin(void *work, const void *desc) {
    sbl__lightmap *l = (sbl__lightmap *)work;
    sbl__map *m = &l->map;
    const sbl_lightmap_desc d = sbl_lightmap_desc_defaults((const sbl_lightmap_desc *)desc);
    const sbl_picture_desc picture = sbl__lightmap_picture(&d);
    sbl__map_begin(m, &picture, d.supersample, d.directional);
    m->atlas = &l->atlas;
    m->channels[SBL_CHANNEL_FINAL] = &m->layers[0].smooth.target;
    l->gutter = SBL__MAX(d.gutter, 0);
    l->sew = d.seams >= 0;
    if (m->across > 1) {
        m->shown = (int *)sbl__alloc(&m->work.core->base, (size_t)d.width * (size_t)d.height, sizeof *m->shown);
        if (!m->shown) return SBL_ERROR_OUT_OF_MEMORY;
    }
    return sbl__atlas_begin(&m->work.core->base, &l->atlas, &m->work.core->scene.geometry, &d);
}

/* >>lightmap: what texels show */

/* Returns the number of the working pixel that is part i of a texel. i: 0 to across * across - 1 */
static size_t sbl__lightmap_part(const sbl__map *m, int texel, int i) {
    const int x = texel % m->size[0] * m->across + i % m->across, y = texel / m->size[0] * m->across + i / m->across;
    return (size_t)y * (size_t)m->desc.width + (size_t)x;
}

static uint32_t sbl__lightmap_part_id(const sbl__map *m, int texel, int i) {
    return sbl__refine_pixel(&m->refine, sbl__lightmap_part(m, texel, i))->id;
}

/* Finds the surface that most working pixels of a supersampled texel show. Sets m->shown to that of these pixels which
   is nearest to the texel's centre, and returns their number. */
static int sbl__lightmap_show(const sbl__map *m, int texel) {
    const int parts = m->across * m->across;
    int i, k, most = 0, nearest = INT_MAX;
    uint32_t id = 0;
    for (i = 0; i < parts; i++) {
        const uint32_t other = sbl__lightmap_part_id(m, texel, i);
        int count = 0;
        for (k = 0; k < parts && other; k++) count += sbl__lightmap_part_id(m, texel, k) == other;
        if (count > most) { most = count; id = other; }
    }
    for (i = 0; i < parts; i++) {
        const int dx = 2 * (i % m->across) + 1 - m->across, dy = 2 * (i / m->across) + 1 - m->across;
        if (sbl__lightmap_part_id(m, texel, i) != id || dx * dx + dy * dy >= nearest) continue;
        nearest = dx * dx + dy * dy;
        m->shown[texel] = (int)sbl__lightmap_part(m, texel, i);
    }
    return most;
}

static sbl_result sbl__lightmap_read(void *work, sbl__slice *slice) {
    sbl__map *m = (sbl__map *)work;
    int *visible = &m->work.core->stats.picture.visible_pixels, i = m->work.stages.at / m->across * m->size[0];
    const int before = *visible;
    const sbl_result result = sbl__map_read(m, slice);
    if (!m->shown) return result;
    *visible = before;  /* sbl__map_read has counted working pixels; the statistic counts texels */
    for (; i < m->work.stages.at / m->across * m->size[0]; i++) *visible += sbl__lightmap_show(m, i) > 0;
    return result;
}

/* >>lightmap: a layer of light */

/* Computes the mean light of a texel's working pixels that show the same surface as the texel. data: 4 floats per
   working pixel, beginning with working pixel number `first` */
static void sbl__lightmap_mean(const sbl__map *m, int texel, const float *data, size_t first, float out[4]) {
    const uint32_t id = sbl__refine_pixel(&m->refine, sbl__map_shown(m, (size_t)texel))->id;
    const int parts = sbl__lightmap_show(m, texel);
    int i, k;
    for (k = 0; k < 4; k++) out[k] = 0;
    for (i = 0; i < m->across * m->across && id; i++) {
        const float *own = data + 4 * (sbl__lightmap_part(m, texel, i) - first);
        if (sbl__lightmap_part_id(m, texel, i) != id) continue;
        for (k = 0; k < 4; k++) out[k] += own[k] / (float)parts;
    }
}

/* Reads rows of m->layer, as means over supersampled texels, into gutters.light, for sbl__gutters_put. */
static sbl_result sbl__lightmap_light(void *work, sbl__slice *slice) {
    sbl__lightmap *l = (sbl__lightmap *)work;
    sbl__map *m = &l->map;
    sbl__core *c = m->work.core;
    const int across = m->across, at = m->work.stages.at;
    const int rows = SBL__MIN(SBL__MAX(1, SBL__READ_PIXELS / m->desc.width / across), m->size[1] - at);
    const int first = at * m->size[0], count = rows * m->size[0], means = m->shown && m->layer == 0;
    const size_t before = (size_t)(at * across) * (size_t)m->desc.width;
    float *light, *data;
    sbl_result result = SBL_SUCCESS;
    int i;
    (void)slice;
    c->device.gl.doing = "reading R";
    if (at == 0) result = sbl__gutters_begin(&c->base, &l->gutters, m->size, l->gutter);
    if (at == 0 && means && result == SBL_SUCCESS) result = sbl__map_image_make(m, 1, &l->mean);
    if (result != SBL_SUCCESS) return result;
    data = light = l->gutters.light + 4 * (size_t)first;
    if (across > 1) data = (float *)sbl__alloc_raw(&c->base, (size_t)count * (size_t)(across * across), 16);
    if (!data) return SBL_ERROR_OUT_OF_MEMORY;
    result = sbl__target_read(&c->device, &m->layers[m->layer].smooth.target, 0, at * across, rows * across, data);
    c->stats.sensors.readbacks++;
    for (i = 0; i < count && across > 1 && result == SBL_SUCCESS; i++)
        sbl__lightmap_mean(m, first + i, data, before, light + 4 * (size_t)i);
    if (across > 1) sbl__free(&c->base, data);
    if (result == SBL_SUCCESS && means) result = sbl__texture_write(&c->device, &l->mean.texture, at, rows, light);
    if (result == SBL_SUCCESS) sbl__gutters_put(&l->gutters, first, count);
    m->work.stages.at += rows;
    return result == SBL_SUCCESS && m->work.stages.at < m->size[1] ? SBL_UNFINISHED : result;
}

static sbl_result sbl__lightmap_gutters(void *work, sbl__slice *slice) {
    return sbl__rings_step(&((sbl__lightmap *)work)->gutters.spread, slice);
}

static sbl_result sbl__lightmap_sew(void *work, sbl__slice *slice) {
    sbl__lightmap *l = (sbl__lightmap *)work;
    sbl_stats *stats = &l->map.work.core->stats;
    sbl__seams *s = &l->seams;
    sbl_result result;
    if (!l->gutter || !l->sew) return SBL_SUCCESS;
    result = sbl__seams_step(s, &l->gutters, &l->atlas, l->map.layer, slice);
    if (l->map.layer) return result;
    stats->lightmap.seams = s->seams;
    stats->lightmap.seam_before = s->before / sbl__refine_luminance(&l->map.refine);
    stats->lightmap.seam_after = s->after / sbl__refine_luminance(&l->map.refine);
    return result;
}

static sbl_result sbl__lightmap_send(void *work, sbl__slice *slice) {
    sbl__lightmap *l = (sbl__lightmap *)work;
    sbl__map *m = &l->map;
    sbl__map_image *image = &l->finals[m->layer];
    sbl_result result = SBL_SUCCESS;
    (void)slice;
    m->work.core->device.gl.doing = "uploading the lightmap";
    if (m->work.stages.at == 0) result = sbl__map_image_make(m, 1, image);
    return result == SBL_SUCCESS ? sbl__map_upload(m, &image->texture, l->gutters.light, &m->work.stages.at) : result;
}

/* Goes back to DEVELOP for the next layer, if there is one. */
static int sbl__lightmap_after_send(void *work) {
    sbl__lightmap *l = (sbl__lightmap *)work;
    sbl__map *m = &l->map;
    const sbl__device *d = &m->work.core->device;
    const int layer_count = sbl__spec_layers(&m->spec);
    int i;
    sbl__gutters_free(d->base, &l->gutters);
    if (m->layer) sbl__map_layer_free(d, &m->layers[m->layer]);
    m->finished = (float)(m->layer + 1) / (float)layer_count;
    if (m->layer + 1 < layer_count) {
        sbl__map_develop_from(m, m->layer + 1);
        return SBL__MAP_DEVELOP;
    }
    sbl__seams_free(d->base, &l->seams);
    m->channels[SBL_CHANNEL_FINAL] = &l->finals[0].target;
    if (m->shown) m->channels[SBL_CHANNEL_RADIANCE] = &l->mean.target;
    for (i = 1; i < layer_count; i++) m->channels[SBL_CHANNEL_SH_0 + i - 1] = &l->finals[i].target;
    return SBL__LIGHTMAP_DONE;
}

static const sbl__stage_row sbl__lightmap_stages[] = {
    SBL__MAP_ROWS(sbl__lightmap_read, sbl__map_preview),
    { sbl__lightmap_light, NULL, NULL, NULL },
    { sbl__lightmap_gutters, NULL, NULL, NULL },
    { sbl__lightmap_sew, NULL, NULL, NULL },
    { sbl__lightmap_send, sbl__lightmap_after_send, NULL, NULL }
};
static const sbl__front_end sbl__lightmap_front_end = {
    "sbl_begin_lightmap", 1, sbl__lightmap_check, sbl__lightmap_begin, sbl__lightmap_stages, SBL__LIGHTMAP_DONE,
    sbl__map_seconds, sbl__map_progress, sbl__lightmap_free
};

/* ======================================================================================================== >>gather
   The front end that measures the light at points of the host, in one job after the other. */

#define SBL__UNIT_SLACK 1e-6     /* normals are normalized if their squared length differs from 1 by more than this */

enum { SBL__GATHER_PREPARE, SBL__GATHER_SETUP, SBL__GATHER_SITES, SBL__GATHER_SENSE, SBL__GATHER_DONE };

typedef struct sbl__gathering {
    sbl__work work;             /* must be first, because pointers to the struct are cast to sbl__work * */
    sbl_readings_desc desc;     /* with defaults */
    int first;                  /* index of the current job's first site among desc.sites */
} sbl__gathering;

static void sbl__gathering_free(void *work) {
    sbl__gathering *g = (sbl__gathering *)work;
    if (g->work.core) sbl__work_free_task(&g->work);
    memset(g, 0, sizeof *g);
}

static sbl_result sbl__gathering_check(const sbl__core *c, const void *desc, sbl__measurement *measurement) {
    const sbl_readings_desc *given = (const sbl_readings_desc *)desc, d = sbl_readings_desc_defaults(given);
    *measurement = sbl__measurement_of(&d.options, d.sensor_kind, d.sensor_fov);
    measurement->every_ray = given && given->options.rays > 0;
    return sbl__check_readings(&c->base, &d, c->scene.draw != NULL);
}

static sbl_result sbl__gathering_begin(void *work, const void *desc) {
    ((sbl__gathering *)work)->desc = sbl_readings_desc_defaults((const sbl_readings_desc *)desc);
    return SBL_SUCCESS;
}

static void sbl__unit_normal(const float from[3], float out[3]) {
    double n[3] = { from[0], from[1], from[2] };
    int k;
    if (fabs(n[0] * n[0] + n[1] * n[1] + n[2] * n[2] - 1) > SBL__UNIT_SLACK) sbl__normalize(n);
    for (k = 0; k < 3; k++) out[k] = (float)n[k];
}

/* Converts a site of the host, or of >>vertices, for a job. number: selects the rotation of the sensor */
static void sbl__site_make(const sbl__work *w, const sbl_site *from, uint32_t number, sbl__site *out) {
    const float usual_offset = sbl__spec_offset(&w->task.spec, &w->core->scene, 0);
    memcpy(out->position, from->position, sizeof out->position);
    sbl__unit_normal(from->normal, out->normal);
    sbl__unit_normal(sbl__all_zero(from->geometric_normal, 3) ? from->normal : from->geometric_normal,
                     out->geometric_normal);
    out->offset = from->offset > 0 ? from->offset : from->offset < 0 ? 0 : usual_offset;
    out->number = number;
    out->guide = out->first = 0;
    out->looks = 1;
}

static sbl_result sbl__gathering_setup(void *work, sbl__slice *slice) {
    sbl__gathering *g = (sbl__gathering *)work;
    (void)slice;
    return sbl__work_make_task(&g->work, g->desc.site_count, 0);
}

static int sbl__gathering_next_job(void *work) {
    sbl__gathering *g = (sbl__gathering *)work;
    if (g->first == g->desc.site_count) return SBL__GATHER_DONE;
    g->work.task.readings = g->desc.readings + g->first;
    g->work.task.site_count = SBL__MIN(SBL__WORK_SITES, g->desc.site_count - g->first);
    return SBL__GATHER_SITES;
}

static sbl_result sbl__gathering_site(void *work, int at) {
    sbl__gathering *g = (sbl__gathering *)work;
    const int number = g->first + at;
    sbl__site_make(&g->work, &g->desc.sites[number], (uint32_t)number, &g->work.sites[at]);
    return SBL_SUCCESS;
}

static int sbl__gathering_after_sense(void *work) {
    sbl__gathering *g = (sbl__gathering *)work;
    sbl_stats *stats = &g->work.core->stats;
    const int count = g->work.task.site_count;
    int i;
    stats->sensors.count += count;
    for (i = 0; i < count; i++) stats->sensors.invalid += !g->work.task.readings[i].valid;
    g->first += count;
    return sbl__gathering_next_job(g);
}

static float sbl__gathering_progress(const void *work) {
    const sbl__gathering *g = (const sbl__gathering *)work;
    if (sbl__work_is_done(&g->work)) return 1;
    return (float)((g->first + sbl__work_measured(&g->work, SBL__GATHER_SENSE)) / SBL__MAX(1, g->desc.site_count));
}

static const sbl__stage_row sbl__gathering_stages[] = {
    { sbl__work_prepare, NULL, NULL, NULL },
    { sbl__gathering_setup, sbl__gathering_next_job, NULL, NULL },
    { NULL, NULL, sbl__gathering_site, sbl__work_site_count },
    { sbl__work_sense, sbl__gathering_after_sense, NULL, NULL }
};
static const sbl__front_end sbl__readings_front_end = {
    "sbl_begin_readings", 0, sbl__gathering_check, sbl__gathering_begin, sbl__gathering_stages, SBL__GATHER_DONE,
    sbl__work_seconds, sbl__gathering_progress, sbl__gathering_free
};

/* ======================================================================================================== >>vertices
   The front end for light at vertices (Kavan, Bargteil and Sloan 2011). R is measured at points on the triangles, in
   one job after the other. An unknown x is the light at one vertex, or at several vertices that are welded because they
   share position and normal. Hat functions h interpolate the unknowns over the triangles. Conjugate gradients solve the
   normal equations that minimise the sum of

       weight (sum of x h - R)^2           for each point; weight is the point's share of its triangle's area
       smoothing area (slope - slope)^2    for each hinge, an edge that two triangles share; the slopes are those of
                                           the light on both sides of the edge, in units of light

   Each triangle adds a 3 x 3 matrix, summed over its points; each hinge adds the outer product of its 4 weights. Areas
   are relative to the mean triangle area of the mesh. */

#define SBL__VERTICES_MIN_POINTS 4      /* minimum number of points on a triangle, unless desc.samples is lower */
#define SBL__VERTICES_MAX_RATIO 8       /* a triangle has at most this many times desc.samples points */
#define SBL__VERTICES_MIN_AREA 1e-9f    /* minimum of sbl__vertices.areas, relative; smaller triangles get this area */
#define SBL__VERTICES_AGREE 0.99985f    /* minimum cosine between the normals of welded vertices: 1 degree */
#define SBL__VERTICES_BACK 0.9f         /* a point is rejected if back faces fill a larger share of its hemisphere */
#define SBL__VERTICES_INSIDE_OUT 0.5    /* if more than this share of a mesh's points see mostly back faces, the mesh is
                                           a room that is modelled inside out, and these points are used after all */
#define SBL__VERTICES_SUMS 16           /* number of floats per triangle in sbl__vertices.sums */
#define SBL__VERTICES_ROUNDING 1e-5f    /* a triangle has rejected points if the weights of its points sum to less than
                                           its area by more than this share of the area */
#define SBL__VERTICES_SPRING 0.02f      /* weight, per area of rejected points, of the mean squared difference between
                                           the light at two corners of their triangle */
#define SBL__VERTICES_PRECISION 1e-6    /* ratio of the residual's norm to its first value at which the solver stops */
#define SBL__VERTICES_RINGS 64          /* maximum number of edges over which light spreads to other vertices */
#define SBL__VERTICES_LIT (-1)          /* in sbl__vertices.neighbours: the unknown has light */

enum {
    SBL__VERTICES_PREPARE, SBL__VERTICES_FACES, SBL__VERTICES_WELD, SBL__VERTICES_SIDES, SBL__VERTICES_SETUP,
    SBL__VERTICES_SITES, SBL__VERTICES_SENSE, SBL__VERTICES_TAKE,  /* repeated for each job */
    SBL__VERTICES_MASS, SBL__VERTICES_BEND, SBL__VERTICES_SOLVE,
    SBL__VERTICES_SPREAD, SBL__VERTICES_MEAN,                      /* repeated for each ring around lit unknowns */
    SBL__VERTICES_WRITE, SBL__VERTICES_DONE
};

/* A mesh that is baked. Numbers of vertices and triangles are consecutive over all parts, unless a comment says "number
   in the scene". */
typedef struct sbl__vertices_part {
    int mesh, first_vertex, first_triangle;
    int vertex_shift, triangle_shift;  /* number in the scene minus number here */
    double area;
    double points, back_points;  /* number of valid points; how many of them see mostly back faces */
} sbl__vertices_part;

/* An edge that two triangles share. sides: number of the edge as a side of each triangle, see >>topology. weights: for
   the two corners opposite the edge, then the two ends of the first side. The sum of weight * light over these four is
   the bend of the light across the edge; stage BEND multiplies it by a factor */
typedef struct sbl__hinge { uint32_t sides[2]; float weights[4]; } sbl__hinge;

/* Names a point by its triangle and its number among the points on that triangle, see sbl__vertices_point. */
typedef struct sbl__vertices_place { int triangle, point; } sbl__vertices_place;

typedef struct sbl__vertices {
    sbl__work work;             /* must be first, because pointers to the struct are cast to sbl__work * */
    int part;                   /* index of the part that sbl__vertices_part_of found last */
    sbl_vertices_desc desc;     /* with defaults */
    sbl__vertices_part *parts;
    int part_count, vertex_count, triangle_count;
    int64_t points, taken;      /* number of all points; number of points in the finished jobs */
    sbl__vertices_place next_site, next_reading;  /* next point of stage SITES; next point of stage TAKE */
    float *normals;             /* per vertex: sum of its triangles' unit normals; after stage WELD, its normal */
    uint32_t *unknowns;         /* per vertex: number of its unknown, which is the lowest number of the vertices that
                                   are welded to it; SBL__NONE if no triangle uses the vertex */
    sbl__hash_table places, ends;  /* vertices by position; sides by their ends */
    uint32_t *corners;          /* per triangle: three vertices; after stage SIDES, their unknowns */
    float *areas;               /* per triangle: area; after stage SIDES, relative to the mean triangle of its mesh */
    float *sums;                /* per triangle: entries 00 01 02 11 12 22 of its symmetric matrix; the sum of its
                                   points' weights; rgb of the right-hand side for each corner */
    float *back_sums;           /* sums over the points that see mostly back faces, laid out like sums; NULL if there
                                   are no such points */
    sbl__hinge *hinges;
    int hinge_count, hinge_room;
    sbl__solver solver;         /* with desc.average nothing is solved: diagonal holds sums of weights, and residual
                                   sums of weighted light */
    int *neighbours;            /* per unknown: SBL__VERTICES_LIT if it has light; otherwise the number of neighbours
                                   that have light, each counted once per triangle */
    int ring, reached;          /* number of rings of unknowns that have got their light from neighbours;
                                   number of unknowns in the current ring */
} sbl__vertices;

static void sbl__vertices_free(void *work) {
    sbl__vertices *s = (sbl__vertices *)work;
    void *const blocks[] = { s->parts, s->normals, s->unknowns, s->corners, s->areas, s->sums, s->back_sums, s->hinges,
                             s->neighbours };
    sbl__base *base = &s->work.core->base;
    int i;
    for (i = 0; i < SBL__COUNT(blocks); i++) sbl__free(base, blocks[i]);
    sbl__hash_table_free(base, &s->places);
    sbl__hash_table_free(base, &s->ends);
    sbl__solver_free(base, &s->solver);
    sbl__work_free_task(&s->work);
    memset(s, 0, sizeof *s);
}

static sbl_result sbl__vertices_check(const sbl__core *c, const void *desc, sbl__measurement *measurement) {
    const sbl_vertices_desc *given = (const sbl_vertices_desc *)desc, d = sbl_vertices_desc_defaults(given);
    *measurement = sbl__measurement_of(&d.options, SBL_SENSOR_HEMICUBE, 135);
    measurement->every_ray = given && given->options.rays > 0;
    return sbl__check_vertices(&c->base, &d, &c->scene);
}

static sbl_result sbl__vertices_begin(void *work, const void *desc) {
    sbl__vertices *s = (sbl__vertices *)work;
    sbl__core *c = s->work.core;
    const sbl__geometry *g = &c->scene.geometry;
    size_t vertices, triangles;
    int i;
    s->desc = sbl_vertices_desc_defaults((const sbl_vertices_desc *)desc);
    s->part_count = s->desc.mesh_count ? s->desc.mesh_count : g->mesh_count;
    s->parts = (sbl__vertices_part *)sbl__alloc(&c->base, (size_t)s->part_count, sizeof *s->parts);
    if (!s->parts) return SBL_ERROR_OUT_OF_MEMORY;
    for (i = 0; i < s->part_count; i++) {
        sbl__vertices_part *part = &s->parts[i];
        part->mesh = s->desc.mesh_count ? s->desc.meshes[i] : i;
        part->first_vertex = s->vertex_count;
        part->first_triangle = s->triangle_count;
        part->vertex_shift = g->meshes[part->mesh].first_vertex - s->vertex_count;
        part->triangle_shift = g->meshes[part->mesh].first_triangle - s->triangle_count;
        s->vertex_count += g->meshes[part->mesh].vertex_count;
        s->triangle_count += g->meshes[part->mesh].triangle_count;
    }
    s->desc.meshes = NULL;
    vertices = (size_t)s->vertex_count;
    triangles = (size_t)s->triangle_count;
    s->normals = (float *)sbl__alloc(&c->base, vertices, 12);
    s->unknowns = (uint32_t *)sbl__alloc_raw(&c->base, vertices, sizeof *s->unknowns);
    s->corners = (uint32_t *)sbl__alloc_raw(&c->base, triangles, 12);
    s->areas = (float *)sbl__alloc_raw(&c->base, triangles, sizeof *s->areas);
    if (!s->normals || !s->unknowns || !s->corners || !s->areas ||
        sbl__hash_table_make(&c->base, &s->places, s->vertex_count) != SBL_SUCCESS ||
        sbl__hash_table_make(&c->base, &s->ends, 3.0 * s->triangle_count) != SBL_SUCCESS)
        return SBL_ERROR_OUT_OF_MEMORY;
    memset(s->unknowns, 0xff, vertices * sizeof *s->unknowns);
    return SBL_SUCCESS;
}

/* >>vertices: welding */

static const sbl__geometry *sbl__vertices_geometry(const sbl__vertices *s) { return &s->work.core->scene.geometry; }

/* Converts the number of a vertex of part s->part to its number in the scene. */
static uint32_t sbl__vertices_vertex(const sbl__vertices *s, uint32_t vertex) {
    return vertex + (uint32_t)s->parts[s->part].vertex_shift;
}

/* Sets s->part to the part that contains a triangle or, if is_vertex is 1, a vertex, and returns the part. The search
   begins at the part that was found last, because most callers ask for ascending numbers. */
static sbl__vertices_part *sbl__vertices_part_of(sbl__vertices *s, int at, int is_vertex) {
    const sbl__vertices_part *p = s->parts;
    int i = s->part;
    if (at < (is_vertex ? p[i].first_vertex : p[i].first_triangle)) i = 0;
    while (i + 1 < s->part_count && at >= (is_vertex ? p[i + 1].first_vertex : p[i + 1].first_triangle)) i++;
    s->part = i;
    return &s->parts[i];
}

/* Computes a triangle's area, stores the numbers of its vertices, and adds its normal to those of its vertices. */
static sbl_result sbl__vertices_face(void *work, int triangle) {
    sbl__vertices *s = (sbl__vertices *)work;
    const sbl__geometry *g = sbl__vertices_geometry(s);
    sbl__vertices_part *part = sbl__vertices_part_of(s, triangle, 0);
    const uint32_t number = (uint32_t)(triangle + part->triangle_shift);
    double face[3];
    const double area = sbl__scene_normal(g, number, face);
    int i, k;
    s->areas[triangle] = (float)area;
    part->area += area;
    for (i = 0; i < 3; i++) {
        const uint32_t vertex = g->indices[3 * (size_t)number + (size_t)i] - (uint32_t)part->vertex_shift;
        s->corners[3 * (size_t)triangle + (size_t)i] = s->unknowns[vertex] = vertex;
        for (k = 0; k < 3; k++) s->normals[3 * (size_t)vertex + (size_t)k] += (float)face[k];
    }
    return SBL_SUCCESS;
}

/* Returns 1 if two vertices are welded: they are in the same part and at the same position, and their normals agree. */
static int sbl__vertices_same(const void *user, uint32_t one, uint32_t other) {
    const sbl__vertices *s = (const sbl__vertices *)user;
    const float *a = s->normals + 3 * (size_t)one, *b = s->normals + 3 * (size_t)other;
    return other >= (uint32_t)s->parts[s->part].first_vertex && sbl__dot(a, b) >= SBL__VERTICES_AGREE &&
           sbl__same_place(sbl__vertices_geometry(s), sbl__vertices_vertex(s, one), sbl__vertices_vertex(s, other));
}

/* Replaces the sum of the normals of a vertex's triangles by the vertex's normal in the scene, or by the normalized sum
   if it has none, and welds the vertex. Vertices without triangles or without a normal are not welded. */
static sbl_result sbl__vertices_weld(void *work, int vertex) {
    sbl__vertices *s = (sbl__vertices *)work;
    const sbl__geometry *g = sbl__vertices_geometry(s);
    float *normal = s->normals + 3 * (size_t)vertex;
    double mean[3] = { normal[0], normal[1], normal[2] };
    uint32_t number;
    int k;
    sbl__vertices_part_of(s, vertex, 1);
    number = sbl__vertices_vertex(s, (uint32_t)vertex);
    if (s->unknowns[vertex] == SBL__NONE) return SBL_SUCCESS;
    if (!sbl__all_zero(g->attributes[number].normal, 3)) memcpy(normal, g->attributes[number].normal, 12);
    else if (!sbl__normalize(mean)) return SBL_SUCCESS;
    else for (k = 0; k < 3; k++) normal[k] = (float)mean[k];
    s->unknowns[vertex] = sbl__hash_table_first(&s->places, sbl__place_hash(g, number), (uint32_t)vertex,
                                                sbl__vertices_same, s);
    return SBL_SUCCESS;
}

/* Gets the four unknowns of a hinge in the order of its weights. */
static void sbl__hinge_unknowns(const sbl__vertices *s, const sbl__hinge *h, size_t out[4]) {
    int i;
    for (i = 0; i < 4; i++) out[i] = sbl__side_end(s->corners, h->sides[i == 1], i < 2 ? 2 : (uint32_t)i - 2);
}

/* Computes the weights of a hinge. The weighted sum of the light at its corners is the difference between the slopes of
   the light on both sides of the edge, when both triangles are unfolded into one plane. It is 0 for linear light. */
static void sbl__hinge_make(const sbl__vertices *s, sbl__hinge *h) {
    const sbl__vertex *vertices = sbl__vertices_geometry(s)->vertices;
    const float *p[4];
    double edge[3], length2 = 0, along[2] = { 0, 0 }, height[2] = { 0, 0 }, norm = 0, w[4] = { 0, 0, 0, 0 };
    size_t at[4];
    int i, k;
    sbl__hinge_unknowns(s, h, at);
    for (i = 0; i < 4; i++) p[i] = vertices[sbl__vertices_vertex(s, (uint32_t)at[i])].position;
    for (k = 0; k < 3; k++) edge[k] = (double)p[3][k] - p[2][k];
    for (k = 0; k < 3; k++) length2 += edge[k] * edge[k];
    for (i = 0; i < 2; i++) {
        for (k = 0; k < 3; k++) along[i] += ((double)p[i][k] - p[2][k]) * edge[k] / length2;
        for (k = 0; k < 3; k++) {
            const double d = (double)p[i][k] - p[2][k] - along[i] * edge[k];
            height[i] += d * d;
        }
        height[i] = sqrt(height[i]);
    }
    for (i = 0; i < 2 && length2 > 0 && height[0] + height[1] > 0; i++) {
        w[i] = height[1 - i] / (height[0] + height[1]);
        w[2] -= w[i] * (1 - along[i]);
        w[3] -= w[i] * along[i];
    }
    for (i = 0; i < 4; i++) norm += w[i] * w[i];
    for (i = 0; i < 4; i++) h->weights[i] = (float)(w[i] / sqrt(SBL__MAX(norm, 1.0)));
}

/* Adds a hinge between a side and the first side with the same ends. If more than two triangles share an edge, the
   first triangle gets a hinge with each of the others. */
static sbl_result sbl__vertices_side(sbl__vertices *s, uint32_t side) {
    const uint32_t other = sbl__first_side(&s->ends, s->corners, side);
    sbl__hinge *hinge;
    if (other == side) return SBL_SUCCESS;
    if (!sbl__grow(&s->work.core->base, &s->hinges, &s->hinge_room, s->hinge_count + 1, sizeof *s->hinges))
        return SBL_ERROR_OUT_OF_MEMORY;
    hinge = &s->hinges[s->hinge_count++];
    hinge->sides[0] = other;
    hinge->sides[1] = side;
    sbl__hinge_make(s, hinge);
    return SBL_SUCCESS;
}

/* Returns the number of points on a triangle. */
static int sbl__vertices_samples(const sbl__vertices *s, int triangle) {
    const double wanted = (double)s->areas[triangle] * s->desc.samples + 0.5;
    const double most = SBL__VERTICES_MAX_RATIO * s->desc.samples;
    return SBL__MAX((int)SBL__MIN(wanted, most), SBL__MIN(SBL__VERTICES_MIN_POINTS, s->desc.samples));
}

/* Makes a triangle's area relative, counts its points, replaces its vertices by their unknowns, and adds its hinges. */
static sbl_result sbl__vertices_sides(void *work, int triangle) {
    sbl__vertices *s = (sbl__vertices *)work;
    const sbl__vertices_part *part = sbl__vertices_part_of(s, triangle, 0);
    const double mean = part->area / SBL__MAX(1, sbl__vertices_geometry(s)->meshes[part->mesh].triangle_count);
    const int smooth = !s->desc.average && s->desc.smoothing > 0;
    uint32_t *corners = s->corners + 3 * (size_t)triangle;
    sbl_result result = SBL_SUCCESS;
    uint32_t i;
    s->areas[triangle] = mean > 0 ? (float)(s->areas[triangle] / mean) : 1;
    s->areas[triangle] = SBL__MAX(s->areas[triangle], SBL__VERTICES_MIN_AREA);
    s->points += sbl__vertices_samples(s, triangle);
    for (i = 0; i < 3; i++) corners[i] = s->unknowns[corners[i]];
    for (i = 0; i < 3 && smooth && result == SBL_SUCCESS; i++)
        result = sbl__vertices_side(s, 3 * (uint32_t)triangle + i);
    return result;
}

/* >>vertices: points */

/* Computes the barycentric weights of point number k: the centre of a sub-triangle that the base 4 digits of k select
   by repeated subdivision into four. Points never lie on an edge (Basu and Owen 2015, "Low Discrepancy Constructions in
   the Triangle"). */
static void sbl__vertices_point(int k, double weights[3]) {
    double scale = 1;
    int i;
    for (i = 0; i < 3; i++) weights[i] = 1 / 3.0;
    for (; k > 0; k /= 4) {
        const int corner = k % 4 - 1;
        for (i = 0; i < 3 && corner >= 0; i++) weights[i] += 0.5 * scale * ((i == corner) - 1 / 3.0);
        scale *= corner >= 0 ? 0.5 : -0.5;
    }
}

/* Makes the site at a point on a triangle as surface.glsl does: the front is the side to which the interpolated normal
   points, and the normal is bent to stay above the triangle's horizon. number: number of the triangle in the scene */
static void sbl__vertices_site(const sbl__geometry *g, uint32_t number, const double weights[3], sbl_site *out) {
    double face[3], normal[3] = { 0, 0, 0 }, height = 0, length2;
    int i, k;
    memset(out, 0, sizeof *out);
    sbl__scene_normal(g, number, face);
    for (k = 0; k < 3; k++) {
        double at = 0;
        for (i = 0; i < 3; i++) {
            const uint32_t vertex = g->indices[3 * (size_t)number + (size_t)i];
            at += weights[i] * g->vertices[vertex].position[k];
            normal[k] += weights[i] * g->attributes[vertex].normal[k];
        }
        out->position[k] = (float)at;
        height += normal[k] * face[k];
    }
    for (k = 0; k < 3 && height < 0; k++) face[k] = -face[k];
    length2 = normal[0] * normal[0] + normal[1] * normal[1] + normal[2] * normal[2];
    if (length2 <= SBL__NORMAL_LEAST || !sbl__normalize(normal)) memcpy(normal, face, sizeof normal);
    height = normal[0] * face[0] + normal[1] * face[1] + normal[2] * face[2];
    for (k = 0; k < 3 && height < SBL__GRAZING; k++) normal[k] += (SBL__GRAZING - height) * face[k];
    sbl__normalize(normal);
    for (k = 0; k < 3; k++) {
        out->normal[k] = (float)normal[k];
        out->geometric_normal[k] = (float)face[k];
    }
}

/* Returns the triangle of a point, gets the point's barycentric weights, sets s->part to the triangle's part, and
   advances *place to the following point. */
static int sbl__vertices_pass(sbl__vertices *s, sbl__vertices_place *place, double weights[3]) {
    const int triangle = place->triangle;
    sbl__vertices_part_of(s, triangle, 0);
    sbl__vertices_point(place->point, weights);
    if (++place->point < sbl__vertices_samples(s, triangle)) return triangle;
    place->point = 0;
    place->triangle++;
    return triangle;
}

static sbl_result sbl__vertices_ask(void *work, int site) {
    sbl__vertices *s = (sbl__vertices *)work;
    sbl_site point;
    double h[3];
    const int triangle = sbl__vertices_pass(s, &s->next_site, h);
    const uint32_t number = (uint32_t)(triangle + s->parts[s->part].triangle_shift);
    sbl__vertices_site(sbl__vertices_geometry(s), number, h, &point);
    sbl__site_make(&s->work, &point, (uint32_t)(s->taken + site), &s->work.sites[site]);
    return SBL_SUCCESS;
}

/* Adds the reading of a point to the sums of its triangle, or to its back_sums if the point sees mostly back faces. */
static sbl_result sbl__vertices_take(void *work, int site) {
    sbl__vertices *s = (sbl__vertices *)work;
    const sbl_reading *r = &s->work.readings[site];
    const int sees_back = r->back_share * r->hit_share > SBL__VERTICES_BACK;
    double h[3];
    const int triangle = sbl__vertices_pass(s, &s->next_reading, h);
    const double weight = (double)s->areas[triangle] / sbl__vertices_samples(s, triangle);
    float *sums;
    int a, b, k;
    s->work.core->stats.sensors.count++;
    s->work.core->stats.sensors.invalid += !r->valid;
    if (!r->valid) return SBL_SUCCESS;
    s->parts[s->part].points += 1;
    s->parts[s->part].back_points += sees_back;
    if (sees_back && !s->back_sums)
        s->back_sums = (float *)sbl__alloc(&s->work.core->base, (size_t)s->triangle_count,
                                           SBL__VERTICES_SUMS * sizeof *s->back_sums);
    sums = sees_back ? s->back_sums : s->sums;
    if (!sums) return SBL_ERROR_OUT_OF_MEMORY;
    sums += SBL__VERTICES_SUMS * (size_t)triangle;
    for (a = 0; a < 3; a++)
        for (b = a; b < 3; b++) *sums++ += (float)(weight * h[a] * h[b]);
    *sums++ += (float)weight;
    for (a = 0; a < 3; a++)
        for (k = 0; k < 3; k++) *sums++ += (float)(weight * h[a] * r->radiance[k]);
    return SBL_SUCCESS;
}

/* >>vertices: the solution */

/* Index into a triangle's sums of each entry of its symmetric 3 x 3 matrix. */
static const unsigned char sbl__mass_at[3][3] = { { 0, 1, 2 }, { 1, 3, 4 }, { 2, 4, 5 } };

static void sbl__vertices_weigh(sbl__vertices *s, size_t unknown, double weight) {
    int k;
    for (k = 0; k < 3; k++) s->solver.diagonal[3 * unknown + (size_t)k] += weight;
}

/* Adds a triangle's sums to the diagonal and the right-hand side. If some of its points were rejected, springs
   between its corners stand in for these, because the remaining points may not determine all three corners. */
static sbl_result sbl__vertices_mass(void *work, int triangle) {
    sbl__vertices *s = (sbl__vertices *)work;
    const sbl__vertices_part *part = sbl__vertices_part_of(s, triangle, 0);
    const int inside_out = part->back_points > SBL__VERTICES_INSIDE_OUT * part->points;
    const uint32_t *corners = s->corners + 3 * (size_t)triangle;
    const size_t first = SBL__VERTICES_SUMS * (size_t)triangle;
    float *sums = s->sums + first, missing, spring;
    int a, b, k;
    for (k = 0; k < SBL__VERTICES_SUMS && inside_out; k++) sums[k] += s->back_sums[first + (size_t)k];
    if (!(sums[6] > 0)) return SBL_SUCCESS;
    missing = s->areas[triangle] - sums[6];
    spring = missing > SBL__VERTICES_ROUNDING * s->areas[triangle] ? SBL__VERTICES_SPRING * missing / 3 : 0;
    for (a = 0; a < 3; a++) {
        s->neighbours[corners[a]] = SBL__VERTICES_LIT;
        for (k = 0; k < 3; k++) s->solver.residual[3 * (size_t)corners[a] + (size_t)k] += sums[7 + 3 * a + k];
        for (b = 0; b < 3 && s->desc.average; b++) sbl__vertices_weigh(s, corners[a], sums[sbl__mass_at[a][b]]);
    }
    for (a = 0; a < 3 && !s->desc.average; a++) {
        for (b = a; b < 3; b++) sums[sbl__mass_at[a][b]] += a == b ? 2 * spring : -spring;
        sbl__vertices_weigh(s, corners[a], sums[sbl__mass_at[a][a]]);
    }
    return SBL_SUCCESS;
}

/* Multiplies the weights of a hinge by the square root of desc.smoothing * area, and adds their squares to the diagonal
   of the normal equations. The area is the smaller one of the two triangles, each without the share of its rejected
   points. */
static sbl_result sbl__vertices_bend(void *work, int hinge) {
    sbl__vertices *s = (sbl__vertices *)work;
    sbl__hinge *h = &s->hinges[hinge];
    float area[2];
    size_t at[4];
    double scale;
    int i;
    for (i = 0; i < 2; i++) area[i] = s->sums[SBL__VERTICES_SUMS * (size_t)(h->sides[i] / 3) + 6];
    scale = sqrt((double)s->desc.smoothing * SBL__MIN(area[0], area[1]));
    sbl__hinge_unknowns(s, h, at);
    for (i = 0; i < 4; i++) {
        h->weights[i] = (float)(h->weights[i] * scale);
        sbl__vertices_weigh(s, at[i], (double)h->weights[i] * h->weights[i]);
    }
    return SBL_SUCCESS;
}

/* Adds one term of the normal equations' matrix, times `direction`, to `product`. There is one term for each triangle,
   then one for each hinge. */
static void sbl__vertices_term(void *user, int term, const double *direction, double *product) {
    const sbl__vertices *s = (const sbl__vertices *)user;
    const size_t triangle = (size_t)term;
    const sbl__hinge *h;
    size_t at[4];
    int a, b, k;
    for (a = 0; a < 3 && term < s->triangle_count; a++)
        for (b = 0; b < 3; b++) {
            const double m = s->sums[SBL__VERTICES_SUMS * triangle + sbl__mass_at[a][b]];
            const double *from = direction + 3 * (size_t)s->corners[3 * triangle + (size_t)b];
            double *to = product + 3 * (size_t)s->corners[3 * triangle + (size_t)a];
            for (k = 0; k < 3; k++) to[k] += m * from[k];
        }
    if (term < s->triangle_count) return;
    h = &s->hinges[term - s->triangle_count];
    sbl__hinge_unknowns(s, h, at);
    for (k = 0; k < 3; k++) {
        double bend = 0;
        for (a = 0; a < 4; a++) bend += h->weights[a] * direction[3 * at[a] + (size_t)k];
        for (a = 0; a < 4; a++) product[3 * at[a] + (size_t)k] += h->weights[a] * bend;
    }
}

static sbl_result sbl__vertices_average(void *work, int unknown) {
    sbl__solver *s = &((sbl__vertices *)work)->solver;
    size_t i = 3 * (size_t)unknown;
    const size_t end = i + 3;
    for (; i < end && s->diagonal[i] > 0; i++) s->solution[i] = s->residual[i] / s->diagonal[i];
    return SBL_SUCCESS;
}

/* >>vertices: extending light to unknowns without valid points */

/* For each corner of a triangle that has no light: adds the light of the corners that have light, and counts these. */
static sbl_result sbl__vertices_spread(void *work, int triangle) {
    sbl__vertices *s = (sbl__vertices *)work;
    const uint32_t *corners = s->corners + 3 * (size_t)triangle;
    int a, b, k;
    for (a = 0; a < 3; a++)
        for (b = 0; b < 3 && s->neighbours[corners[a]] != SBL__VERTICES_LIT; b++) {
            const double *from = s->solver.solution + 3 * (size_t)corners[b];
            double *to = s->solver.solution + 3 * (size_t)corners[a];
            if (s->neighbours[corners[b]] != SBL__VERTICES_LIT) continue;
            for (k = 0; k < 3; k++) to[k] += from[k];
            s->neighbours[corners[a]]++;
        }
    return SBL_SUCCESS;
}

/* Divides the sum of the light of an unknown's neighbours by their number. */
static sbl_result sbl__vertices_mean(void *work, int unknown) {
    sbl__vertices *s = (sbl__vertices *)work;
    double *light = s->solver.solution + 3 * (size_t)unknown;
    int k;
    if (s->neighbours[unknown] <= 0) return SBL_SUCCESS;
    for (k = 0; k < 3; k++) light[k] /= s->neighbours[unknown];
    s->neighbours[unknown] = SBL__VERTICES_LIT;
    s->reached++;
    return SBL_SUCCESS;
}

static int sbl__vertices_after_mean(void *work) {
    sbl__vertices *s = (sbl__vertices *)work;
    const int more = s->reached && ++s->ring < SBL__VERTICES_RINGS;
    s->reached = 0;
    return more ? SBL__VERTICES_SPREAD : SBL__VERTICES_WRITE;
}

static sbl_result sbl__vertices_write(void *work, int vertex) {
    sbl__vertices *s = (sbl__vertices *)work;
    const uint32_t unknown = s->unknowns[vertex];
    int k;
    for (k = 0; k < 3; k++) {
        const double x = unknown == SBL__NONE ? 0 : s->solver.solution[3 * (size_t)unknown + (size_t)k];
        s->desc.radiance[3 * (size_t)vertex + (size_t)k] = x > 0 ? (float)SBL__MIN(x, (double)FLT_MAX) : 0;
    }
    return SBL_SUCCESS;
}

/* >>vertices: stages */

/* Allocates the sites, readings and sums, and sets up the solver. */
static sbl_result sbl__vertices_setup(void *work, sbl__slice *slice) {
    sbl__vertices *s = (sbl__vertices *)work;
    sbl__base *base = &s->work.core->base;
    (void)slice;
    s->solver.user = s;
    s->solver.term = sbl__vertices_term;
    s->solver.term_count = s->triangle_count + s->hinge_count;
    s->solver.precision2 = SBL__VERTICES_PRECISION * SBL__VERTICES_PRECISION;

    s->sums = (float *)sbl__alloc(base, (size_t)s->triangle_count, SBL__VERTICES_SUMS * sizeof *s->sums);
    s->neighbours = (int *)sbl__alloc(base, (size_t)s->vertex_count, sizeof *s->neighbours);
    if (!s->sums || !s->neighbours || sbl__solver_make(base, &s->solver, s->vertex_count) != SBL_SUCCESS)
        return SBL_ERROR_OUT_OF_MEMORY;
    return sbl__work_make_task(&s->work, (double)s->points, 1);
}

static sbl_result sbl__vertices_solve(void *work, sbl__slice *slice) {
    sbl__vertices *s = (sbl__vertices *)work;
    return s->desc.average ? SBL_SUCCESS : sbl__solver_step(&s->solver, slice);
}

static int sbl__vertices_next_job(void *work) {
    sbl__vertices *s = (sbl__vertices *)work;
    s->taken += s->work.task.site_count;
    s->work.task.site_count = (int)SBL__MIN(s->points - s->taken, SBL__WORK_SITES);
    return s->work.task.site_count ? SBL__VERTICES_SITES : SBL__VERTICES_MASS;
}

static int sbl__vertices_count(void *work) { return ((sbl__vertices *)work)->vertex_count; }
static int sbl__vertices_averages(void *work) {
    return ((sbl__vertices *)work)->desc.average ? ((sbl__vertices *)work)->vertex_count : 0;
}
static int sbl__vertices_triangles(void *work) { return ((sbl__vertices *)work)->triangle_count; }
static int sbl__vertices_hinges(void *work) { return ((sbl__vertices *)work)->hinge_count; }

/* Frees the memory, because only the sbl__work is needed when the work is done. */
static int sbl__vertices_after_write(void *work) {
    sbl__work w;
    sbl__work_free_task((sbl__work *)work);
    w = *(const sbl__work *)work;
    sbl__vertices_free(work);
    *(sbl__work *)work = w;
    return SBL__VERTICES_DONE;
}

static double *sbl__vertices_seconds(const void *work) {
    const sbl__work *w = (const sbl__work *)work;
    if (w->stages.stage == SBL__VERTICES_SENSE) return &w->core->stats.seconds.gather;
    return w->stages.stage < SBL__VERTICES_SENSE ? &w->core->stats.seconds.surface : &w->core->stats.seconds.refine;
}

#define SBL__VERTICES_SENSING 0.95f  /* progress when all points are measured */

static float sbl__vertices_progress(const void *work) {
    const sbl__vertices *s = (const sbl__vertices *)work;
    const double done = (double)s->taken + sbl__work_measured(&s->work, SBL__VERTICES_SENSE);
    if (sbl__work_is_done(&s->work)) return 1;
    return SBL__VERTICES_SENSING * (float)(done / (double)SBL__MAX(1, s->points));
}

static const sbl__stage_row sbl__vertices_stages[] = {
    { sbl__work_prepare, NULL, NULL, NULL },
    { NULL, NULL, sbl__vertices_face, sbl__vertices_triangles },
    { NULL, NULL, sbl__vertices_weld, sbl__vertices_count },
    { NULL, NULL, sbl__vertices_sides, sbl__vertices_triangles },
    { sbl__vertices_setup, sbl__vertices_next_job, NULL, NULL },
    { NULL, NULL, sbl__vertices_ask, sbl__work_site_count },
    { sbl__work_sense, NULL, NULL, NULL },
    { NULL, sbl__vertices_next_job, sbl__vertices_take, sbl__work_site_count },
    { NULL, NULL, sbl__vertices_mass, sbl__vertices_triangles },
    { NULL, NULL, sbl__vertices_bend, sbl__vertices_hinges },
    { sbl__vertices_solve, NULL, sbl__vertices_average, sbl__vertices_averages },
    { NULL, NULL, sbl__vertices_spread, sbl__vertices_triangles },
    { NULL, sbl__vertices_after_mean, sbl__vertices_mean, sbl__vertices_count },
    { NULL, sbl__vertices_after_write, sbl__vertices_write, sbl__vertices_count }
};
static const sbl__front_end sbl__vertices_front_end = {
    "sbl_begin_vertices", 0, sbl__vertices_check, sbl__vertices_begin, sbl__vertices_stages, SBL__VERTICES_DONE,
    sbl__vertices_seconds, sbl__vertices_progress, sbl__vertices_free
};

/* ======================================================================================================== >>probes
   The front end for points in the air. Probes are measured in batches, by two kinds of sites: HEMISPHERES measure R for
   normals that lie on rings all over the sphere, and for the six sides of a cube; RAYS trace one ray each. If sensors
   trace rays, HEMISPHERES measure only the light from lamps, and RAYS measure the light from surfaces and sky. If
   sensors rasterise views, HEMISPHERES measure all light, and RAYS measure only distances. This is a round. Probes that
   turn out to be inside something are moved, if desc.move allows it, and measured in another round. */

/* Number of rings of normals, and number of normals on a ring (AROUND), if sensors trace rays or, for VIEW, rasterise
   views. With these numbers, the aliasing of a point light is at most 0.4 % (rays) or 1.4 % (views) of the norm of the
   light's first four coefficients. */
#define SBL__PROBE_RINGS 10
#define SBL__PROBE_AROUND 32
#define SBL__PROBE_VIEW_RINGS 6
#define SBL__PROBE_VIEW_AROUND 22
#define SBL__PROBES_BATCH 128      /* maximum number of probes per batch */
#define SBL__PROBE_LOOKS 4         /* number of looks for each side of the cube; a normal on a ring has one, because
                                      the harmonics average many normals */
#define SBL__PROBE_LAMP_SHARE 64   /* options.rays divided by the number of rays that a look of HEMISPHERES sends to
                                      lamps */
#define SBL__PROBE_LAMP_LEAST 32   /* minimum number of rays that a look of HEMISPHERES sends to lamps: twice the number
                                      that a ratio estimate needs (SBL_SPARSE in lamps.glsl) */
#define SBL__PROBE_LAMP_MOST 256   /* maximum number of rays that a look of HEMISPHERES sends to lamps */
#define SBL__PROBE_INSIDE 0.25     /* a probe is inside something if more than this share of its rays hit back faces */
#define SBL__PROBE_BEYOND 0.125    /* largest distance that a probe moves beyond a back face / desc.move */
#define SBL__PROBE_BARELY 0.015625 /* if desc.move limits the distance beyond a back face to less than this share of
                                      desc.move, the probe does not move through that face */

enum { SBL__PROBE_HEMISPHERES, SBL__PROBE_RAYS, SBL__PROBE_KINDS };  /* kinds of sites of a probe */

enum { SBL__PROBES_PREPARE, SBL__PROBES_SETUP, SBL__PROBES_SITES, SBL__PROBES_SENSE, SBL__PROBES_TAKE,
       SBL__PROBES_DONE };

/* A probe of the batch, and sums over the readings of its sites in the current round. */
typedef struct sbl__probe_sum {
    int number, invalid;           /* index of the probe in desc.probes; 1 if any reading of the round is not valid */
    float position[3];             /* world position in this round */
    double sh[9][3], cube[6][3];   /* weighted sums that become the fields of sbl_probe */
    double hits, back;             /* number of rays that hit a surface; number of these that hit a back face */
    double weight[8], distance[8], squared[8];  /* per octant: sums of w, w * distance, w * distance^2 */
    float exits[8][4];             /* per octant: direction and distance of the nearest back face, seen from the
                                      position that the host wants. Distance 0: there is none, or the probe has moved
                                      through it already */
} sbl__probe_sum;

typedef struct sbl__probes {
    sbl__work work;                /* must be first, because pointers to the struct are cast to sbl__work * */
    sbl_probes_desc desc;          /* with defaults */
    sbl__spec specs[SBL__PROBE_KINDS];
    int lamps_apart;               /* 1: sensors trace rays, so HEMISPHERES measure only the light from lamps */
    int rings, around;             /* number of rings of normals; number of normals on a ring */
    double ring[SBL__PROBE_RINGS], ring_weight[SBL__PROBE_RINGS];  /* z of each ring, 0 to 1; weights, whose sum is 1 */
    uint32_t *sequence;            /* sbl__sequence_at makes the directions of a probe's rays from it */
    sbl__probe_sum *sums;          /* one entry for each probe of the batch that is measured in this round */
    int first, taken;              /* first probe of the batch; number of probes in the batch */
    int count, round;              /* number of entries in sums; number of the round, from 0 */
    int kind, from;                /* kind of the current job's sites, SBL__PROBE_HEMISPHERES or SBL__PROBE_RAYS;
                                      index of the job's first site among all sites of that kind in this round */
} sbl__probes;

static void sbl__probes_free(void *work) {
    sbl__probes *g = (sbl__probes *)work;
    sbl__base *base = &g->work.core->base;
    sbl__free(base, g->sequence);
    sbl__free(base, g->sums);
    sbl__work_free_task(&g->work);
    memset(g, 0, sizeof *g);
}

/* Evaluates the spherical harmonics of sbl_probe in a unit direction. */
static void sbl__harmonics_of(const double d[3], double out[9]) {
    const double a = 0.5 / sqrt(SBL__PI), b = a * sqrt(3.0), c = a * sqrt(15.0);
    const double x = d[0], y = d[1], z = d[2];
    out[0] = a;
    out[1] = b * y;
    out[2] = b * z;
    out[3] = b * x;
    out[4] = c * x * y;
    out[5] = c * y * z;
    out[6] = 0.5 * a * sqrt(5.0) * (3 * z * z - 1);
    out[7] = c * x * z;
    out[8] = 0.5 * c * (x * x - y * y);
}

/* Computes nodes and weights of the Gauss-Legendre quadrature between 0 and 1. The nodes are the roots of the Legendre
   polynomial of degree `count`, found by Newton's method. */
static void sbl__gauss_nodes(int count, double *nodes, double *weights) {
    int i, k, step;
    for (i = 0; i < count; i++) {
        double x = cos(SBL__PI * (i + 0.75) / (count + 0.5)), slope = 1;
        for (step = 0; step < 20; step++) {
            double before = 1, value = x;
            for (k = 2; k <= count; k++) {
                const double next = ((2 * k - 1) * x * value - (k - 1) * before) / k;
                before = value;
                value = next;
            }
            slope = count * (x * value - before) / (x * x - 1);
            x -= value / slope;
        }
        nodes[i] = 0.5 + 0.5 * x;
        weights[i] = 1 / ((1 - x * x) * slope * slope);
    }
}

static int sbl__probe_normals(const sbl__probes *g) { return g->rings * g->around; }

/* Returns the number of sites of one kind that a probe has. */
static int sbl__probe_sites(const sbl__probes *g, int kind) {
    return kind == SBL__PROBE_RAYS ? g->desc.options.rays : sbl__probe_normals(g) + 6;
}

/* Computes normal number i. As a function of the normal, the even part of R has a kink where the normal is
   perpendicular to the direction of a light, so it needs many axes; the odd part is smooth. Therefore the rings fill
   only the half z > 0, within which a light at a pole causes no kink; every other normal is replaced by its antipode,
   which doubles the number of axes; and every other ring is rotated by half a step. */
static void sbl__probe_normal(const sbl__probes *g, int i, double out[3]) {
    const int ring = i / g->around, step = i % g->around, sign = (ring + step) & 1 ? -1 : 1;
    const double angle = 2 * SBL__PI * (step + 0.5 * (ring & 1)) / g->around, z = g->ring[ring], r = sqrt(1 - z * z);
    out[0] = sign * r * cos(angle);
    out[1] = sign * r * sin(angle);
    out[2] = sign * z;
}

/* Computes the direction of a probe's site number i, of kind g->kind: the direction of a ray, or a normal. The normals
   of the cube's sides come last. number: number of the probe */
static void sbl__probe_direction(const sbl__probes *g, int number, int i, double out[3]) {
    const int side = i - sbl__probe_normals(g);
    double u[2], r;
    if (g->kind == SBL__PROBE_HEMISPHERES && side < 0) {
        sbl__probe_normal(g, i, out);
    } else if (g->kind == SBL__PROBE_HEMISPHERES) {
        out[0] = out[1] = out[2] = 0;
        out[side / 2] = side & 1 ? -1 : 1;
    } else {
        sbl__sequence_at(g->sequence, i, sbl__sensor_seed((uint32_t)number, g->desc.options.seed), u);
        out[2] = 1 - 2 * u[0];
        r = sqrt(1 - out[2] * out[2]);
        out[0] = r * cos(2 * SBL__PI * u[1]);
        out[1] = r * sin(2 * SBL__PI * u[1]);
    }
}

/* Gets the position at which the host wants probe number i. */
static void sbl__probe_asked(const sbl_probes_desc *d, int i, float out[3]) {
    int k;
    for (k = 0; k < 3; k++) {
        const double share = (i % SBL__MAX(1, d->grid[k]) + 0.5) / SBL__MAX(1, d->grid[k]);
        out[k] = d->positions ? d->positions[3 * (size_t)i + (size_t)k]
                              : (float)((1 - share) * d->lowest[k] + share * d->highest[k]);
        i /= SBL__MAX(1, d->grid[k]);
    }
}

static sbl_result sbl__probes_check(const sbl__core *c, const void *desc, sbl__measurement *measurement) {
    const sbl_probes_desc d = sbl_probes_desc_defaults((const sbl_probes_desc *)desc);
    *measurement = sbl__measurement_of(&d.options, SBL_SENSOR_HEMICUBE, 135);
    return sbl__check_probes(&c->base, &d, c->scene.draw != NULL);
}

static sbl_result sbl__probes_begin(void *work, const void *desc) {
    sbl__probes *g = (sbl__probes *)work;
    const float (*const bounds)[3] = (const float (*)[3])g->work.core->scene.geometry.bounds;
    g->desc = sbl_probes_desc_defaults((const sbl_probes_desc *)desc);
    if (sbl__all_zero(g->desc.lowest, 3) && sbl__all_zero(g->desc.highest, 3)) {
        memcpy(g->desc.lowest, bounds[0], sizeof g->desc.lowest);
        memcpy(g->desc.highest, bounds[1], sizeof g->desc.highest);
    }
    g->lamps_apart = g->work.measurement.options.backend == SBL_BACKEND_TRACE;
    g->rings = g->lamps_apart ? SBL__PROBE_RINGS : SBL__PROBE_VIEW_RINGS;
    g->around = g->lamps_apart ? SBL__PROBE_AROUND : SBL__PROBE_VIEW_AROUND;
    sbl__gauss_nodes(g->rings, g->ring, g->ring_weight);
    return SBL_SUCCESS;
}

/* Makes the specs of both kinds of sites, and allocates memory for a batch. */
static sbl_result sbl__probes_setup(void *work, sbl__slice *slice) {
    sbl__probes *g = (sbl__probes *)work;
    sbl__core *c = g->work.core;
    sbl__spec *hemispheres = &g->specs[SBL__PROBE_HEMISPHERES], *rays = &g->specs[SBL__PROBE_RAYS];
    const int most = SBL__MAX(sbl__probe_sites(g, SBL__PROBE_HEMISPHERES), g->desc.options.rays);
    const int batch = SBL__MIN(SBL__PROBES_BATCH, g->desc.probe_count);
    const int lamp_rays = SBL__MAX(g->desc.options.rays / SBL__PROBE_LAMP_SHARE, SBL__PROBE_LAMP_LEAST);
    sbl__measurement measurement = g->work.measurement;
    (void)slice;
    measurement.options.rays = SBL__MIN(lamp_rays, SBL__PROBE_LAMP_MOST);
    if (g->lamps_apart) {
        measurement.options.mode = SBL_MODE_DIRECT;
        measurement.options.epsilon = 0;
    }
    sbl__spec_make(hemispheres, &measurement, &c->scene, &c->desc);
    if (g->lamps_apart) hemispheres->without_sky = hemispheres->no_light = hemispheres->one_ray = hemispheres->rays = 1;
    hemispheres->looks = SBL__PROBE_LOOKS;
    measurement = g->work.measurement;
    measurement.options.backend = SBL_BACKEND_TRACE;
    measurement.options.rays = measurement.every_ray = 1;
    sbl__spec_make(rays, &measurement, &c->scene, &c->desc);
    rays->lamp_rays = 0;
    rays->one_ray = 1;
    g->sequence = sbl__sequence_make(&c->base, 1, g->desc.options.rays, 1);
    g->sums = (sbl__probe_sum *)sbl__alloc(&c->base, (size_t)batch, sizeof *g->sums);
    return g->sequence && g->sums ? sbl__work_make_task(&g->work, (double)most * batch, 1) : SBL_ERROR_OUT_OF_MEMORY;
}

/* Begins a job with the sites of kind g->kind from g->from on. */
static int sbl__probes_next_job(sbl__probes *g) {
    g->work.task.spec = g->specs[g->kind];
    g->work.task.site_count = SBL__MIN(SBL__WORK_SITES, g->count * sbl__probe_sites(g, g->kind) - g->from);
    return SBL__PROBES_SITES;
}

/* Begins a round with HEMISPHERES, or with RAYS if HEMISPHERES measure only lamps and the scene has none. */
static int sbl__probes_round(sbl__probes *g) {
    g->kind = g->lamps_apart && !g->work.core->scene.lights.leaves ? SBL__PROBE_RAYS : SBL__PROBE_HEMISPHERES;
    g->from = 0;
    return sbl__probes_next_job(g);
}

/* Begins a batch with the probes from g->first on. */
static int sbl__probes_batch(void *work) {
    sbl__probes *g = (sbl__probes *)work;
    int i;
    g->taken = g->count = SBL__MIN(SBL__PROBES_BATCH, g->desc.probe_count - g->first);
    g->round = 0;
    memset(g->sums, 0, sizeof *g->sums * (size_t)g->count);
    for (i = 0; i < g->count; i++) {
        g->sums[i].number = g->first + i;
        sbl__probe_asked(&g->desc, g->first + i, g->sums[i].position);
    }
    return g->count ? sbl__probes_round(g) : SBL__PROBES_DONE;
}

static sbl_result sbl__probes_site(void *work, int at) {
    sbl__probes *g = (sbl__probes *)work;
    const int each = sbl__probe_sites(g, g->kind), i = (g->from + at) % each;
    const sbl__probe_sum *sum = &g->sums[(g->from + at) / each];
    sbl__site *site = &g->work.sites[at];
    double direction[3];
    int k;
    memset(site, 0, sizeof *site);
    sbl__probe_direction(g, sum->number, i, direction);
    for (k = 0; k < 3; k++) site->normal[k] = site->geometric_normal[k] = (float)direction[k];
    memcpy(site->position, sum->position, sizeof site->position);
    site->number = (uint32_t)sum->number * (uint32_t)each + (uint32_t)i;
    site->looks = g->kind == SBL__PROBE_HEMISPHERES && i >= sbl__probe_normals(g) ? SBL__PROBE_LOOKS : 1;
    return SBL_SUCCESS;
}

/* Adds the reading of a site to the harmonics: the radiance along a ray, or R at a normal. A ray's radiance is also
   added to the sides of the cube. site: number of the site among the sites of its probe. d: its direction */
static void sbl__probe_add(const sbl__probes *g, sbl__probe_sum *sum, int site, const double d[3],
                           const sbl_reading *r) {
    /* the factors A_i of the formula for R in the comment of sbl_probe */
    static const double factors[9] = { 1, 2 / 3.0, 2 / 3.0, 2 / 3.0, 0.25, 0.25, 0.25, 0.25, 0.25 };
    const int rays = g->kind == SBL__PROBE_RAYS;
    const double share = rays ? 1.0 / g->desc.options.rays : g->ring_weight[site / g->around] / g->around;
    const double area = 4 * SBL__PI * share;
    double y[9];
    int i, k;
    sbl__harmonics_of(d, y);
    for (i = 0; i < 9; i++) {
        const double weight = area * y[i] / (rays ? 1 : factors[i]);
        for (k = 0; k < 3; k++) sum->sh[i][k] += weight * (double)r->radiance[k];
    }
    for (i = 0; i < 6 && rays; i++) {
        const double cosine = i & 1 ? -d[i / 2] : d[i / 2], weight = area / SBL__PI * SBL__MAX(cosine, 0.0);
        for (k = 0; k < 3; k++) sum->cube[i][k] += weight * (double)r->radiance[k];
    }
}

/* Adds the distance at which a ray hit a surface. exits: 1: also remembers the nearest back face of each octant */
static void sbl__probe_meet(sbl__probe_sum *sum, const double d[3], const sbl_reading *r, int exits) {
    const int octant = (d[0] > 0) | (d[1] > 0) << 1 | (d[2] > 0) << 2;
    const double distance = (double)r->hit_mean;
    float *way = sum->exits[octant];
    int i, k;
    if (!(r->hit_share > 0)) return;
    sum->hits++;
    for (i = 0; i < 8; i++) {
        const double along = ((i & 1 ? d[0] : -d[0]) + (i & 2 ? d[1] : -d[1]) + (i & 4 ? d[2] : -d[2])) / sqrt(3.0);
        const double weight = SBL__MAX(along, 0.0);
        sum->weight[i] += weight;
        sum->distance[i] += weight * distance;
        sum->squared[i] += weight * distance * distance;
    }
    if (!(r->back_share > 0)) return;
    sum->back++;
    if (!exits || (way[3] > 0 && way[3] <= r->hit_mean)) return;
    for (k = 0; k < 3; k++) way[k] = (float)d[k];
    way[3] = r->hit_mean;
}

static sbl_result sbl__probes_take(void *work, int at) {
    sbl__probes *g = (sbl__probes *)work;
    const int each = sbl__probe_sites(g, g->kind), i = (g->from + at) % each, side = i - sbl__probe_normals(g);
    const sbl_reading *r = &g->work.readings[at];
    sbl__probe_sum *sum = &g->sums[(g->from + at) / each];
    double d[3];
    int k;
    sum->invalid |= !r->valid;
    if (g->kind == SBL__PROBE_HEMISPHERES && side >= 0) {
        for (k = 0; k < 3; k++) sum->cube[side][k] += (double)r->radiance[k];
        return SBL_SUCCESS;
    }
    sbl__probe_direction(g, sum->number, i, d);
    if (g->lamps_apart || g->kind == SBL__PROBE_HEMISPHERES) sbl__probe_add(g, sum, i, d, r);
    if (g->kind == SBL__PROBE_RAYS) sbl__probe_meet(sum, d, r, g->round == 0 && g->desc.move > 0);
    return SBL_SUCCESS;
}

/* Converts the sums of a probe to the probe that the host gets. */
static void sbl__probe_make(const sbl__probes *g, const sbl__probe_sum *sum, sbl_probe *out) {
    int i, k, finite;
    memset(out, 0, sizeof *out);
    for (i = 0; i < 9; i++) for (k = 0; k < 3; k++) out->sh[i][k] = (float)sum->sh[i][k];
    for (i = 0; i < 6; i++) for (k = 0; k < 3; k++) out->cube[i][k] = (float)sum->cube[i][k];
    for (i = 0; i < 8; i++) {
        out->distance[i] = sum->weight[i] > 0 ? (float)(sum->distance[i] / sum->weight[i]) : 0;
        out->distance_squared[i] = sum->weight[i] > 0 ? (float)(sum->squared[i] / sum->weight[i]) : 0;
    }
    out->sky = (float)(1 - sum->hits / g->desc.options.rays);
    out->back_share = sum->hits > 0 ? (float)(sum->back / sum->hits) : 0;
    finite = sbl__all_finite(&out->sh[0][0], 27) && sbl__all_finite(&out->cube[0][0], 18) &&
             sbl__all_finite(out->distance, 8) && sbl__all_finite(out->distance_squared, 8);
    if (!finite) memset(out, 0, sizeof *out);
    out->valid = finite && !sum->invalid && sum->back <= SBL__PROBE_INSIDE * g->desc.options.rays;
    memcpy(out->position, sum->position, sizeof out->position);
}

/* Moves a probe through the back face nearest to the position that the host wants, among those not tried yet. Returns 0
   if none is within reach of desc.move. */
static int sbl__probe_move(const sbl__probes *g, sbl__probe_sum *sum) {
    const double most = (double)g->desc.move;
    float from[3], *way = NULL;
    double distance;
    int i, k;
    for (i = 0; i < 8; i++)
        if (sum->exits[i][3] > 0 && (!way || sum->exits[i][3] < way[3])) way = sum->exits[i];
    if (!way || (double)way[3] > (1 - SBL__PROBE_BARELY) * most) return 0;
    distance = SBL__MIN((double)way[3] + SBL__PROBE_BEYOND * most, most);
    sbl__probe_asked(&g->desc, sum->number, from);
    for (k = 0; k < 3; k++) sum->position[k] = (float)((double)from[k] + distance * (double)way[k]);
    way[3] = 0;
    return 1;
}

/* Ends a round: writes the probes to the host's array, and begins the next round with the invalid probes that can move.
   A probe that is invalid in every round keeps the result of the first round. */
static int sbl__probes_close(sbl__probes *g) {
    sbl_stats *stats = &g->work.core->stats;
    int i, left = 0;
    stats->sensors.count += g->count;
    for (i = 0; i < g->count; i++) {
        const sbl__probe_sum *sum = &g->sums[i];
        sbl__probe_sum next;
        sbl_probe probe;
        sbl__probe_make(g, sum, &probe);
        if (probe.valid || g->round == 0) g->desc.probes[sum->number] = probe;
        if (g->round == 0) stats->sensors.invalid += !probe.valid;
        else stats->sensors.invalid -= probe.valid;
        memset(&next, 0, sizeof next);
        next.number = sum->number;
        memcpy(next.exits, sum->exits, sizeof next.exits);
        if (!probe.valid && sbl__probe_move(g, &next)) g->sums[left++] = next;
    }
    g->count = left;
    g->round++;
    if (left) return sbl__probes_round(g);
    g->first += g->taken;
    return sbl__probes_batch(g);
}

static int sbl__probes_after_take(void *work) {
    sbl__probes *g = (sbl__probes *)work;
    g->from += g->work.task.site_count;
    if (g->from == g->count * sbl__probe_sites(g, g->kind)) {
        g->from = 0;
        g->kind++;
    }
    return g->kind < SBL__PROBE_KINDS ? sbl__probes_next_job(g) : sbl__probes_close(g);
}

static float sbl__probes_progress(const void *work) {
    const sbl__probes *g = (const sbl__probes *)work;
    double part = g->from + sbl__work_measured(&g->work, SBL__PROBES_SENSE);
    if (sbl__work_is_done(&g->work)) return 1;
    part = 0.5 * (part / SBL__MAX(1, g->count * sbl__probe_sites(g, g->kind)) + g->kind);
    return (float)((g->first + (g->round ? 1 : part) * g->taken) / SBL__MAX(1, g->desc.probe_count));
}

static const sbl__stage_row sbl__probes_stages[] = {
    { sbl__work_prepare, NULL, NULL, NULL },
    { sbl__probes_setup, sbl__probes_batch, NULL, NULL },
    { NULL, NULL, sbl__probes_site, sbl__work_site_count },
    { sbl__work_sense, NULL, NULL, NULL },
    { NULL, sbl__probes_after_take, sbl__probes_take, sbl__work_site_count }
};
static const sbl__front_end sbl__probes_front_end = {
    "sbl_begin_probes", 0, sbl__probes_check, sbl__probes_begin, sbl__probes_stages, SBL__PROBES_DONE,
    sbl__work_seconds, sbl__probes_progress, sbl__probes_free
};

/* ======================================================================================================== >>inspect
   Measures one sensor of a finished picture again, as a job of one site. Views are read back when the job has drawn
   them; rays are traced once more, with one invocation per ray. */

#define SBL__INSPECT_ACROSS 64  /* width in texels of the target that the program for rays towards lamps draws into */

/* The result, which the host may read until the next inspection. */
typedef struct sbl__inspection {
    sbl__job job;               /* kept, because the next inspection uses its textures again */
    sbl_sensor_ray *rays;
    sbl_sensor_lamp *lamps;
} sbl__inspection;

typedef struct sbl__inspect_request {
    sbl__core *core;
    sbl__map *map;              /* the finished picture or lightmap */
    sbl__inspection *found;
    int pixel;                  /* number of the working pixel */
    float *radiance, *weights;  /* the host's arrays for the sheet; NULL: not wanted */
    sbl__site site;
    sbl__look look;             /* the sensor's first look, which is repeated */
    sbl_reading reading;        /* of the first look alone */
    float layers[3 * (SBL__LAYERS - 1)];  /* further layers of light of the first look, see sbl__task */
    sbl_sensor out;             /* the result */
} sbl__inspect_request;

static void sbl__inspection_clear(sbl__base *base, sbl__inspection *i) {
    sbl__free(base, i->rays);
    sbl__free(base, i->lamps);
    i->rays = NULL;
    i->lamps = NULL;
}

static void sbl__inspection_free(const sbl__device *d, sbl__inspection *i) {
    sbl__inspection_clear(d->base, i);
    sbl__job_free(d, &i->job);
}

/* Returns the slot of the look, the same as when the picture was made. */
static int sbl__inspect_slot(const sbl__job *j) { return j->task.first_look % sbl__job_slots(j)->count; }

/* Returns the index in found->lamps of the lamp in a leaf of the lamp tree. Appends the lamp if it is new. */
static int sbl__inspect_lamp(sbl__inspect_request *k, int leaf) {
    const sbl__geometry *g = &k->core->scene.geometry;
    const uint32_t code = k->core->scene.lights.codes[leaf], kind = code >> SBL__LAMP_KIND_SHIFT;
    uint32_t number = code & ((1u << SBL__LAMP_KIND_SHIFT) - 1);
    sbl_sensor_lamp lamp, *const lamps = k->found->lamps;
    int i;
    memset(&lamp, 0, sizeof lamp);
    lamp.kind = kind == SBL__LAMP_TRIANGLE    ? SBL_LAMP_TRIANGLE
              : kind == SBL__LAMP_SKY_TEXEL   ? SBL_LAMP_SKY_TEXEL
                                              : SBL_LAMP_LIGHT;
    lamp.mesh = -1;
    if (lamp.kind == SBL_LAMP_TRIANGLE) {
        number = k->core->scene.hierarchy.order[number];
        lamp.mesh = (int)g->vertices[g->indices[3 * (size_t)number]].object;
        number -= (uint32_t)g->meshes[lamp.mesh].first_triangle;
    }
    lamp.number = (int)number;
    for (i = 0; i < k->out.lamp_count; i++)
        if (lamps[i].kind == lamp.kind && lamps[i].mesh == lamp.mesh && lamps[i].number == lamp.number) return i;
    lamps[k->out.lamp_count++] = lamp;
    return i;
}

static sbl_result sbl__inspect_aim(sbl__device *d, const sbl__job *j, const sbl__batch *b) {
    const sbl_result result = sbl__aim_use(j, b, SBL__INSPECT, b->slots->blocks, 1);
    if (result != SBL_SUCCESS) return result;
    sbl__set_int(d, "parts", j->aim.parts);
    sbl__set_int(d, "sheet_slot", sbl__inspect_slot(j));
    sbl__rays_send(d, b, &b->blocks->target, b->slots->blocks);
    return SBL_SUCCESS;
}

/* Runs the program for rays over the hemisphere or, if lamps is 1, the program for rays towards lamps, for the look of
   the request, with size[0] x size[1] invocations. *out: the first output of all invocations, 4 floats each, then the
   second output; the caller frees *out, also after an error */
static sbl_result sbl__inspect_run(const sbl__inspect_request *k, int lamps, const int size[2], float **out) {
    sbl__device *d = &k->core->device;
    const sbl__job *j = &k->found->job;
    const size_t count = (size_t)size[0] * (size_t)size[1];
    sbl__slots slots;
    sbl__blocks blocks;
    sbl__batch b;
    sbl_result result;
    memset(&blocks, 0, sizeof blocks);
    slots.columns = slots.count = 1;
    slots.blocks[0] = size[0];
    slots.blocks[1] = size[1];
    sbl__job_batch(j, j->task.first_look, 1, &b);
    b.slots = &slots;
    b.slot = 0;
    b.blocks = &blocks;
    *out = (float *)sbl__alloc_raw(d->base, count, 32);
    result = *out ? sbl__blocks_make(d, &blocks, 2, size[0], size[1]) : SBL_ERROR_OUT_OF_MEMORY;
    if (result == SBL_SUCCESS) result = lamps ? sbl__inspect_aim(d, j, &b) : sbl__trace_draw(d, &j->trace, &b, 0, 0);
    if (result == SBL_SUCCESS) result = sbl__target_read(d, &blocks.target, 0, 0, size[1], *out);
    if (result == SBL_SUCCESS) result = sbl__target_read(d, &blocks.target, 1, 0, size[1], *out + 4 * count);
    sbl__blocks_free(d, &blocks);
    return result;
}

/* Reads the rays over the hemisphere. The sheet is one row with a texel per ray. */
static sbl_result sbl__inspect_rays(sbl__inspect_request *k) {
    sbl__base *base = &k->core->base;
    const sbl__task *task = &k->found->job.task;
    const int rays = task->spec.rays, size[2] = { 4, (rays + 3) / 4 };
    uint32_t *sequence = sbl__sequence_make(base, 1, rays, 1);
    const uint32_t *guide = task->spec.guided ? sbl__guide_words(task->guides, k->site.guide) : NULL;
    float *data = NULL;
    sbl_result result = sequence ? sbl__inspect_run(k, 0, size, &data) : SBL_ERROR_OUT_OF_MEMORY;
    int i, n;
    for (i = 0; i < rays && result == SBL_SUCCESS; i++) {
        const float *sum = data + 4 * (size_t)i, *hits = sum + 4 * (size_t)(size[0] * size[1]);
        sbl_sensor_ray *ray = &k->found->rays[k->out.ray_count++];
        float weight = 1 / (float)rays;
        double u[2];
        ray->lamp = -1;
        sbl__sequence_at(sequence, i, sbl__sensor_seed(k->site.number, task->spec.seed), u);
        if (guide) weight *= (float)sbl__guide_warp(guide, u);
        sbl__cosine_direction(k->look.normal, u, ray->direction);
        if (hits[0] > 0) ray->distance = sum[3] > 0 ? -hits[2] : hits[2];
        for (n = 0; n < 3; n++) ray->radiance[n] = sum[n] / weight;
        if (k->radiance) memcpy(k->radiance + 4 * i, ray->radiance, sizeof ray->radiance);
        if (k->radiance) k->radiance[4 * i + 3] = ray->distance;
        if (k->weights) k->weights[i] = weight;
        k->out.weight_sum += weight;
    }
    sbl__free(base, data);
    sbl__free(base, sequence);
    return result;
}

/* >>inspect: views */

/* Reads the look's views, which together are the sheet, from the view texture, and computes the weights of texels. */
static sbl_result sbl__inspect_sheet(sbl__inspect_request *k) {
    sbl__core *c = k->core;
    const sbl__job *j = &k->found->job;
    const sbl__raster *r = &j->raster;
    const sbl__lens *lens = &r->lenses[SBL__LENS_SITE];
    const sbl__layout *l = &lens->layout;
    const int width = r->target.width, pitch = sbl__layout_pitch(l, 0), height = sbl__layout_pitch(l, 1);
    float *rows = (float *)sbl__alloc_raw(&c->base, (size_t)width * (size_t)l->sheet[1], 16);
    float *table = (float *)sbl__alloc(&c->base, (size_t)pitch * (size_t)height, 8);
    int corner[2], x, y, i, face;
    double weights = 0;
    sbl_result result = rows && table ? SBL_SUCCESS : SBL_ERROR_OUT_OF_MEMORY;
    sbl__raster_corner(lens, sbl__inspect_slot(j), corner);
    for (face = 0; face < l->view_count && result == SBL_SUCCESS; face++)
        for (y = 0; y < l->rects[face][3]; y++) sbl__weights_row(l, j->task.spec.paper, face, y, table);
    if (result == SBL_SUCCESS)
        result = sbl__target_read(&c->device, &r->target, 0, corner[1], l->sheet[1], rows);
    for (y = 0; y < l->sheet[1] && result == SBL_SUCCESS; y++)
        for (x = 0; x < l->sheet[0]; x++) {
            const float *from = rows + 4 * ((size_t)y * (size_t)width + (size_t)(corner[0] + x));
            const float *weight = table + 2 * ((size_t)y * (size_t)pitch + (size_t)x);
            const size_t texel = (size_t)y * (size_t)l->sheet[0] + (size_t)x;
            for (i = 0; i < 3 && k->radiance; i++) k->radiance[4 * texel + (size_t)i] = from[i] / r->radiance_scale;
            if (k->radiance) k->radiance[4 * texel + 3] = from[3] * c->scene.geometry.extent * weight[1];
            if (k->weights) k->weights[texel] = weight[0];
            weights += weight[0];
        }
    k->out.weight_sum = (float)weights;
    sbl__free(&c->base, rows);
    sbl__free(&c->base, table);
    return result;
}

static void sbl__inspect_views(sbl__inspect_request *k) {
    const sbl__layout *l = sbl__job_layout(&k->found->job);
    sbl_sensor *out = &k->out;
    int face, i;
    out->view_count = l ? l->view_count : 0;
    for (face = 0; face < out->view_count; face++) {
        sbl_sensor_view *v = &out->views[face];
        double right[3], up[3], forward[3], range[4];
        memcpy(v->rect, l->rects[face], sizeof v->rect);
        sbl__view_axes(&k->look, face, right, up, forward);
        sbl__view_range(l, face, range);
        for (i = 0; i < 3; i++) {
            v->right[i] = (float)right[i];
            v->up[i] = (float)up[i];
            v->forward[i] = (float)forward[i];
        }
        v->x0 = (float)range[0]; v->x1 = (float)range[1]; v->y0 = (float)range[2]; v->y1 = (float)range[3];
    }
}

/* >>inspect: rays towards lamps */

/* Adds the outputs out_light and out_way of an invocation of lamps.glsl to the result. is_ray: 1 if the invocation
   traced a ray; 0 if it describes one of the lamps or clusters that the look chose */
static void sbl__inspect_take(sbl__inspect_request *k, const float *light, const float *way, int is_ray) {
    const int state = (int)light[3], lamp = state ? sbl__inspect_lamp(k, (int)way[3]) : 0;
    sbl_sensor_lamp *l = &k->found->lamps[lamp];
    if (!state) return;
    l->rays += is_ray || state > 1;
    l->open += state == (is_ray ? 1 : 2);
    if (is_ray) {
        sbl_sensor_ray *ray = &k->found->rays[k->out.ray_count++];
        ray->lamp = lamp;
        memcpy(ray->direction, way, sizeof ray->direction);
        memcpy(ray->radiance, light, sizeof ray->radiance);
    } else if (l->kind != SBL_LAMP_SKY_TEXEL)
        memcpy(l->unhindered, light, sizeof l->unhindered);
}

/* Reads the sum of light from lamps, measured by the job, then traces its rays towards lamps again to read each. */
static sbl_result sbl__inspect_lamps(sbl__inspect_request *k) {
    sbl__device *d = &k->core->device;
    const sbl__job *j = &k->found->job;
    const int rays = j->task.spec.lamp_rays, count = rays + SBL__LAMPS, parts = j->aim.parts;
    const int size[2] = { SBL__INSPECT_ACROSS, (count + SBL__INSPECT_ACROSS - 1) / SBL__INSPECT_ACROSS };
    const int columns = sbl__job_slots(j)->columns, slot = sbl__inspect_slot(j);
    float *data = NULL, *light = (float *)sbl__alloc_raw(d->base, (size_t)columns * (size_t)parts, 16);
    sbl_result result = SBL_ERROR_OUT_OF_MEMORY;
    int i, n;
    if (light) result = sbl__target_read(d, &j->aim.light.target, 0, slot / columns * parts, parts, light);
    for (i = 0; i < parts && result == SBL_SUCCESS; i++)
        for (n = 0; n < 3; n++)
            k->out.from_lamps[n] += light[4 * ((size_t)columns * (size_t)i + (size_t)(slot % columns)) + (size_t)n] /
                                (float)parts / sbl__job_scale(j);
    sbl__free(d->base, light);
    if (result == SBL_SUCCESS) result = sbl__inspect_run(k, 1, size, &data);
    for (i = 0; i < count && result == SBL_SUCCESS; i++) {
        /* The outputs of the lamps follow those of the rays, but the lamps are taken first. */
        const int from = i < SBL__LAMPS ? rays + i : i - SBL__LAMPS;
        const float *out = data + 4 * (size_t)from;
        sbl__inspect_take(k, out, out + 4 * (size_t)(size[0] * size[1]), from < rays);
    }
    sbl__free(d->base, data);
    return result;
}

/* >>inspect: the job */

/* Checks the arguments of sbl_inspect_sensor, and sets the request's pixel and the size of the sheet. */
static sbl_result sbl__inspect_check(sbl__inspect_request *k, int x, int y, const sbl_sensor *sensor,
                                     size_t texel_count) {
    const sbl__map *m = k->map;
    const int finished = m && sbl__work_is_done(&m->work);
    sbl__check check = { &k->core->base, NULL, SBL_LOG_ITEM_INVALID_ARGUMENT, "sbl_inspect_sensor", 0 };
    size_t texels;
    if (!sensor) {
        sbl__mistake(&check, "sensor is NULL");
        return SBL_ERROR_INVALID_ARGUMENT;
    }
    if (!finished || m->scene_version != k->core->scene.version) {
        check.item = SBL_LOG_ITEM_WRONG_ORDER;
        sbl__mistake(&check, "%s", !finished ? "there is no finished picture; call sbl_render_picture first" :
                     "the scene has changed since the picture was made; call sbl_render_picture again");
        return SBL_ERROR_STATE;
    }
    if (x < 0 || y < 0 || x >= m->size[0] || y >= m->size[1]) {
        sbl__mistake(&check, "pixel %d %d lies outside of the picture's %d x %d", x, y, m->size[0], m->size[1]);
        return SBL_ERROR_INVALID_ARGUMENT;
    }
    k->pixel = (int)sbl__map_shown(m, (size_t)y * (size_t)m->size[0] + (size_t)x);
    sbl__spec_sheet(&m->spec, &k->out.sheet_width, &k->out.sheet_height);
    texels = (size_t)k->out.sheet_width * (size_t)k->out.sheet_height;
    if (!sbl__refine_pixel(&m->refine, (size_t)k->pixel)->id)
        sbl__mistake(&check, "pixel %d %d shows no surface", x, y);
    else if ((k->radiance || k->weights) && texel_count < texels)
        sbl__mistake(&check, "texel_count is %.0f; the sheet has %d x %d texels", (double)texel_count,
                     k->out.sheet_width, k->out.sheet_height);
    return sbl__check_end(&check);
}

/* Fills in those fields of k->out that are not set yet. */
static void sbl__inspect_tell(sbl__inspect_request *k) {
    const sbl__pixel *p = sbl__refine_pixel(&k->map->refine, (size_t)k->pixel);
    const sbl_reading *r = &k->reading;
    sbl_sensor *out = &k->out;
    int i;
    out->backend = k->map->work.measurement.options.backend;
    memcpy(out->site.position, p->position, sizeof p->position);
    memcpy(out->site.normal, p->normal, sizeof p->normal);
    memcpy(out->site.geometric_normal, p->geometric_normal, sizeof p->geometric_normal);
    out->site.offset = p->offset;
    memcpy(out->position, k->look.position, sizeof out->position);
    memcpy(out->normal, k->look.normal, sizeof out->normal);
    memcpy(out->radiance, p->sensed ? p->radiance : r->radiance, sizeof out->radiance);
    out->noise = p->sensed ? sbl__noise(&k->map->refine, p) : r->noise;
    out->looks = p->sensed ? p->looks : 1;
    for (i = 0; i < 3; i++) out->from_surroundings[i] = SBL__MAX(r->radiance[i] - out->from_lamps[i], 0.0f);
    out->back_share = r->back_share * r->hit_share;
    out->hit_min = r->hit_min;
    out->hit_mean = r->hit_mean;
    out->valid = r->valid;
    out->sensed = p->sensed;
    out->level = p->level ? p->level - 1 : 0;
    sbl__inspect_views(k);
    out->rays = k->found->rays;
    out->lamps = k->found->lamps;
}

/* Repeats the first look of the pixel's sensor, in the slot that this look had, so that every rounding is the same. */
static sbl_result sbl__inspect(sbl__inspect_request *k) {
    sbl__core *c = k->core;
    sbl__inspection *f = k->found;
    sbl__job *j = &k->found->job;
    sbl__slice slice = sbl__slice_of(&c->desc, 0);
    sbl__task task;
    int lamp_rays;
    sbl_result result = SBL_UNFINISHED;
    sbl__refine_task(&k->map->refine, &task);
    lamp_rays = task.spec.lamp_rays;
    f->rays = (sbl_sensor_ray *)sbl__alloc(&c->base, (size_t)(task.spec.rays + lamp_rays), sizeof *f->rays);
    f->lamps = (sbl_sensor_lamp *)sbl__alloc(&c->base, (size_t)(SBL__LAMPS + lamp_rays), sizeof *f->lamps);
    if (!f->rays || !f->lamps) return SBL_ERROR_OUT_OF_MEMORY;
    task.sites = &k->site;
    task.readings = &k->reading;
    task.layers = k->layers;
    task.site_count = 1;
    task.first_look = sbl__refine_pixel(&k->map->refine, (size_t)k->pixel)->look;
    sbl__refine_site(&k->map->refine, k->pixel, 0, 1, &k->site);
    sbl__look_make(&task.spec, &k->site, 0, &k->look);
    sbl__job_begin(j, &c->scene, &task);
    while (result == SBL_UNFINISHED) {
        result = sbl__job_step(&c->device, j, &slice);
        if (result != SBL_UNFINISHED || j->stages.stage != SBL__JOB_READ || j->lens != SBL__LENS_SITE) continue;
        /* The look must be read now, because the stuck tests that follow overwrite its textures. */
        c->device.gl.doing = "inspecting a sensor";
        result = sbl__job_layout(j) ? sbl__inspect_sheet(k) : sbl__inspect_rays(k);
        if (result == SBL_SUCCESS && lamp_rays) result = sbl__inspect_lamps(k);
        if (result == SBL_SUCCESS) result = SBL_UNFINISHED;
    }
    if (result == SBL_SUCCESS) sbl__inspect_tell(k);
    return result;
}

/* ======================================================================================================== >>trial
   Tests the driver when a context is created. Some drivers accept every call but draw nothing, or something wrong. The
   scene of the test is one triangle: a camera's G-buffer must show it, and a sensor's rays must hit it. */

#define SBL__TRIAL_SIZE 8   /* width and height of the G-buffer, pixels */
#define SBL__TRIAL_RAYS 16

/* Makes a scene of one white, two-sided triangle in the plane z = 0, around the origin. */
static sbl_result sbl__trial_scene(sbl__core *c) {
    static const float corners[9] = { -4, -4, 0, 4, -4, 0, 0, 4, 0 };
    sbl_material material;
    sbl_scene_desc desc;
    sbl_mesh mesh;
    memset(&material, 0, sizeof material);
    memset(&desc, 0, sizeof desc);
    memset(&mesh, 0, sizeof mesh);
    material.albedo[0] = material.albedo[1] = material.albedo[2] = 1;
    mesh.positions.data = corners;
    mesh.vertex_count = 3;
    desc.meshes = &mesh;
    desc.materials = &material;
    desc.mesh_count = desc.material_count = 1;
    return sbl__scene_make(&c->device, &c->scene, &desc);
}

/* Draws the G-buffer of a camera at z = 2 that looks at the origin. *shown: 1 if a pixel near the centre shows the
   triangle at the right position, and a corner pixel that the triangle does not cover shows nothing */
static sbl_result sbl__trial_camera(sbl__core *c, sbl__surface *surface, sbl__gbuffer *gbuffer, int *shown) {
    const float *middle, *corner;
    float pixels[SBL__TRIAL_SIZE * SBL__TRIAL_SIZE][4];
    sbl__camera camera;
    sbl__slice slice = sbl__slice_of(&c->desc, 0);
    sbl__surface_job job;
    sbl_picture_desc view;
    sbl_result result = sbl__surface_make(&c->device, surface, SBL__TRIAL_SIZE, SBL__TRIAL_SIZE, 0);
    if (result == SBL_SUCCESS)
        result = sbl__gbuffer_make(&c->device, gbuffer, SBL__TRIAL_SIZE, SBL__TRIAL_SIZE, &surface->depth);
    if (result != SBL_SUCCESS) return result;
    memset(&view, 0, sizeof view);
    memset(&job, 0, sizeof job);
    sbl_look_at(view.world_to_view, 0, 0, 2, 0, 0, 0, 0, 1, 0);
    sbl_perspective(view.view_to_clip, 120, 1);
    sbl__camera_make(&camera, &view, &c->scene.geometry);
    job.scene = &c->scene;
    job.camera = &camera;
    job.gbuffer = gbuffer;
    do result = sbl__surface_step(&c->device, surface, &job, &slice); while (result == SBL_UNFINISHED);
    if (result == SBL_SUCCESS)
        result = sbl__target_read(&c->device, &gbuffer->target, SBL__GBUFFER_POSITION, 0, SBL__TRIAL_SIZE, pixels);
    middle = pixels[SBL__TRIAL_SIZE * SBL__TRIAL_SIZE / 2 + SBL__TRIAL_SIZE / 2];
    corner = pixels[SBL__TRIAL_SIZE - 1];
    *shown = result == SBL_SUCCESS && fabs((double)middle[0] - 0.433) < 1e-2 &&
             fabs((double)middle[1] + 0.433) < 1e-2 && fabs((double)middle[2]) < 1e-3 && middle[3] > 0 &&
             corner[3] == 0;
    return result;
}

/* Traces the rays of a sensor at unit distance from the triangle. *met: 1 if most rays hit the triangle at the right
   distance, and find its radiance of 0.5, which is due to ambient light */
static sbl_result sbl__trial_rays(sbl__core *c, int *met) {
    sbl_readings_desc desc;
    sbl__gathering gathering;
    sbl__measurement measurement;
    sbl_reading reading;
    sbl__slice slice = sbl__slice_of(&c->desc, 0);
    sbl_result result;
    sbl_site site;
    memset(&desc, 0, sizeof desc);
    memset(&site, 0, sizeof site);
    memset(&reading, 0, sizeof reading);
    memset(&gathering, 0, sizeof gathering);
    site.position[2] = 1;
    site.normal[2] = -1;
    desc.sites = &site;
    desc.readings = &reading;
    desc.site_count = 1;
    desc.options.mode = SBL_MODE_AMBIENT;
    desc.options.backend = SBL_BACKEND_TRACE;
    desc.options.epsilon = 0.5f;
    desc.options.rays = SBL__TRIAL_RAYS;
    result = sbl__gathering_check(c, &desc, &measurement);
    if (result == SBL_SUCCESS)
        result = sbl__work_begin(&gathering.work, &sbl__readings_front_end, c, &measurement, &desc);
    if (result == SBL_SUCCESS) do result = sbl__work_step(&gathering.work, &slice); while (result == SBL_UNFINISHED);
    sbl__gathering_free(&gathering);
    *met = result == SBL_SUCCESS && reading.hit_share > 0.5f && reading.hit_min > 0.99f && reading.hit_min < 1.5f &&
           fabs((double)reading.radiance[1] - 0.5 * (double)reading.hit_share) < 1e-3;
    return result;
}

/* Runs both tests. If one fails, logs the driver's name and returns SBL_ERROR_GL. */
static sbl_result sbl__trial(sbl__core *c) {
    sbl__surface surface;
    sbl__gbuffer gbuffer;
    int shown = 0, met = 0;
    sbl_result result = sbl__trial_scene(c);
    memset(&surface, 0, sizeof surface);
    memset(&gbuffer, 0, sizeof gbuffer);
    if (result == SBL_SUCCESS) result = sbl__trial_camera(c, &surface, &gbuffer, &shown);
    if (result == SBL_SUCCESS) result = sbl__trial_rays(c, &met);
    if (result == SBL_SUCCESS && !(shown && met)) {
        sbl__log(&c->base, SBL_LOG_ERROR, SBL_LOG_ITEM_DRAWS_WRONG, "the driver \"%s\" (%s) %s; use another driver or "
                 "another version", c->device.gl.capabilities.renderer, c->device.gl.capabilities.version,
                 shown ? "traces a known ray incorrectly" : "does not draw a known triangle correctly");
        result = SBL_ERROR_GL;
    }
    sbl__gbuffer_free(&c->device, &gbuffer);
    sbl__surface_free(&c->device, &surface);
    sbl__job_free(&c->device, &c->job);
    sbl__scene_free(&c->device, &c->scene);
    memset(&c->scene, 0, sizeof c->scene);
    memset(&c->stats, 0, sizeof c->stats);
    return result;
}

/* ======================================================================================================== >>egl
   Creates a headless GL context if the host defines SBL_EGL and gives no GL loader, and makes it current while the
   library works. Without SBL_EGL, the host must have a GL context.

   A thread has one current GL context, whichever interface made it current. If GLX did, eglMakeCurrent fails with
   EGL_BAD_ACCESS, and all GL calls would go to the context of GLX. EGL can neither see nor release that context, so
   calls of the host are refused then. */

#ifdef SBL_EGL

/* A GL context, and the surfaces and the API that are used with it. All fields are 0 if there is no context. */
typedef struct sbl__egl { EGLDisplay display; EGLContext context; EGLSurface draw, read; EGLenum api; } sbl__egl;

static sbl_gl_function sbl__egl_function(const char *name, void *user) {
    (void)user;
    return (sbl_gl_function)eglGetProcAddress(name);
}

static void sbl__egl_destroy(sbl__egl *e) {
    if (e->context == EGL_NO_CONTEXT) return;
    if (eglGetCurrentContext() == e->context)
        eglMakeCurrent(e->display, EGL_NO_SURFACE, EGL_NO_SURFACE, EGL_NO_CONTEXT);
    if (e->draw != EGL_NO_SURFACE) eglDestroySurface(e->display, e->draw);
    eglDestroyContext(e->display, e->context);
    memset(e, 0, sizeof *e);
}

/* Returns the error of an EGL function that has failed. Some drivers set none. */
static EGLint sbl__egl_error(void) {
    const EGLint error = eglGetError();
    return error == EGL_SUCCESS ? EGL_NOT_INITIALIZED : error;
}

/* Logs that the library's own context cannot be made current, and returns the result for the host. */
static sbl_result sbl__egl_refuse(const sbl__base *base, const char *function) {
    sbl__log(base, SBL_LOG_ERROR, SBL_LOG_ITEM_NO_GL, "%s: the headless context cannot be made current, because a GL "
             "context of another interface, such as GLX, is current in this thread; release that one before "
             "(glXMakeCurrent(display, None, NULL)), or set get_gl_function in sbl_context_desc (glXGetProcAddress), "
             "so that sbl.h works in it", function);
    return SBL_ERROR_STATE;
}

/* Tries to create a context on a display and to make it current. pbuffer: 1 if its surface is a pbuffer, 0 if it has no
   surface. *taken: becomes 1 if a context of another interface is current. Returns EGL_SUCCESS or an error. */
static EGLint sbl__egl_try(sbl__egl *e, EGLDisplay display, int pbuffer, int *taken) {
    static const EGLint context_attributes[] = { EGL_CONTEXT_MAJOR_VERSION, 3, EGL_CONTEXT_MINOR_VERSION, 3,
                                                 EGL_CONTEXT_OPENGL_PROFILE_MASK,
                                                 EGL_CONTEXT_OPENGL_CORE_PROFILE_BIT, EGL_NONE };
    static const EGLint surface_attributes[] = { EGL_WIDTH, 16, EGL_HEIGHT, 16, EGL_NONE };
    EGLint config_attributes[] = { EGL_SURFACE_TYPE, 0, EGL_RENDERABLE_TYPE, EGL_OPENGL_BIT, EGL_NONE };
    EGLConfig config = NULL;
    EGLint count = 0, error;
    if (display == EGL_NO_DISPLAY || !eglInitialize(display, NULL, NULL) || !eglBindAPI(EGL_OPENGL_API))
        return sbl__egl_error();
    config_attributes[1] = pbuffer ? EGL_PBUFFER_BIT : 0;
    if (!eglChooseConfig(display, config_attributes, &config, 1, &count) || count < 1) return sbl__egl_error();
    e->context = eglCreateContext(display, config, EGL_NO_CONTEXT, context_attributes);
    if (e->context == EGL_NO_CONTEXT) return sbl__egl_error();
    e->display = display;
    e->draw = e->read = pbuffer ? eglCreatePbufferSurface(display, config, surface_attributes) : EGL_NO_SURFACE;
    if (pbuffer == (e->draw != EGL_NO_SURFACE) && eglMakeCurrent(display, e->draw, e->read, e->context))
        return EGL_SUCCESS;
    error = sbl__egl_error();
    *taken |= error == EGL_BAD_ACCESS;
    sbl__egl_destroy(e);
    return error;
}

static sbl__egl sbl__egl_current(void) {
    const sbl__egl current = { eglGetCurrentDisplay(), eglGetCurrentContext(), eglGetCurrentSurface(EGL_DRAW),
                               eglGetCurrentSurface(EGL_READ), eglQueryAPI() };
    return current;
}

/* Saves the host's EGL state in *b, creates a context, and sets the GL loader in *desc. Tries Mesa's surfaceless
   platform, then up to 16 EGL devices, then a pbuffer on the default display. Displays are never terminated, because
   all users in a process share them. */
static sbl_result sbl__egl_open(sbl__egl *e, const sbl__base *base, sbl__egl *b, sbl_context_desc *desc) {
    const PFNEGLGETPLATFORMDISPLAYEXTPROC get_display =
        (PFNEGLGETPLATFORMDISPLAYEXTPROC)eglGetProcAddress("eglGetPlatformDisplayEXT");
    const PFNEGLQUERYDEVICESEXTPROC query_devices =
        (PFNEGLQUERYDEVICESEXTPROC)eglGetProcAddress("eglQueryDevicesEXT");
    const char *extensions = eglQueryString(EGL_NO_DISPLAY, EGL_EXTENSIONS);
    const int platforms = get_display && extensions;
    EGLDeviceEXT devices[16];
    EGLint count = 0, i, error = EGL_NOT_INITIALIZED;
    int taken = 0;
    *b = sbl__egl_current();
    desc->get_gl_function = sbl__egl_function;
    if (platforms && strstr(extensions, "EGL_MESA_platform_surfaceless"))
        error = sbl__egl_try(e, get_display(EGL_PLATFORM_SURFACELESS_MESA, EGL_DEFAULT_DISPLAY, NULL), 0, &taken);
    if (error != EGL_SUCCESS && platforms && query_devices && strstr(extensions, "EGL_EXT_platform_device") &&
        query_devices(16, devices, &count))
        for (i = 0; i < count && error != EGL_SUCCESS; i++)
            error = sbl__egl_try(e, get_display(EGL_PLATFORM_DEVICE_EXT, devices[i], NULL), 0, &taken);
    if (error != EGL_SUCCESS) error = sbl__egl_try(e, eglGetDisplay(EGL_DEFAULT_DISPLAY), 1, &taken);
    if (error == EGL_SUCCESS) return SBL_SUCCESS;
    if (taken) return sbl__egl_refuse(base, "sbl_create");
    sbl__log(base, SBL_LOG_ERROR, SBL_LOG_ITEM_NO_GL, "no headless OpenGL 3.3 context could be created (tried the "
             "surfaceless platform, all devices and a pbuffer; EGL error 0x%04x); install a GL driver such as Mesa's, "
             "or set get_gl_function in sbl_context_desc", (unsigned)error);
    return SBL_ERROR_UNSUPPORTED;
}

/* Makes the library's own context current, if there is one and it is not current already. *b: receives the host's EGL
   state if it changes, otherwise zeroes. Returns 0 if the context cannot be made current. */
static int sbl__egl_enter(const sbl__egl *e, sbl__egl *b) {
    memset(b, 0, sizeof *b);
    if (e->context == EGL_NO_CONTEXT || eglGetCurrentContext() == e->context) return 1;
    *b = sbl__egl_current();
    eglBindAPI(EGL_OPENGL_API);
    if (eglMakeCurrent(e->display, e->draw, e->read, e->context)) return 1;
    eglBindAPI(b->api);
    memset(b, 0, sizeof *b);
    return 0;
}

/* Restores the host's EGL state if it was saved. */
static void sbl__egl_leave(const sbl__egl *e, const sbl__egl *b) {
    if (!b->api) return;
    if (e->display != EGL_NO_DISPLAY) eglMakeCurrent(e->display, EGL_NO_SURFACE, EGL_NO_SURFACE, EGL_NO_CONTEXT);
    eglBindAPI(b->api);
    if (b->context != EGL_NO_CONTEXT) eglMakeCurrent(b->display, b->draw, b->read, b->context);
}

/* Returns whether the library's own context, if there is one, can be made current. If another context of EGL is
   current, it can. */
static int sbl__egl_ready(const sbl__egl *e) {
    sbl__egl before;
    int ready;
    if (e->context == EGL_NO_CONTEXT || eglGetCurrentContext() != EGL_NO_CONTEXT) return 1;
    ready = sbl__egl_enter(e, &before);
    sbl__egl_leave(e, &before);
    return ready;
}

#else  /* without SBL_EGL */

typedef struct sbl__egl { int none; } sbl__egl;

static sbl_result sbl__egl_open(sbl__egl *e, const sbl__base *base, sbl__egl *b, sbl_context_desc *desc) {
    (void)e; (void)b; (void)desc;
    sbl__log(base, SBL_LOG_ERROR, SBL_LOG_ITEM_INVALID_CONTEXT_DESC, "sbl_context_desc: get_gl_function is NULL; give "
             "the loader of your GL context, or define SBL_EGL for a headless context");
    return SBL_ERROR_INVALID_ARGUMENT;
}

static sbl_result sbl__egl_refuse(const sbl__base *base, const char *function) {
    (void)base; (void)function;
    return SBL_ERROR_STATE;
}

static int sbl__egl_ready(const sbl__egl *e) { (void)e; return 1; }
static int sbl__egl_enter(const sbl__egl *e, sbl__egl *b) { (void)e; (void)b; return 1; }
static void sbl__egl_leave(const sbl__egl *e, const sbl__egl *b) { (void)e; (void)b; }
static void sbl__egl_destroy(sbl__egl *e) { (void)e; }

#endif

/* ======================================================================================================== >>public
   The functions declared above. Each checks its arguments, saves and sets the host's GL state, delegates to a room, and
   restores the state. */

/* The front ends: verb, noun and struct. A row makes the public functions sbl_begin_NOUN and sbl_VERB_NOUN, and the
   field NOUN of sbl_context. */
#define SBL__FRONT_ENDS(X) \
    X(render, picture, sbl__picture) \
    X(bake, lightmap, sbl__lightmap) \
    X(gather, readings, sbl__gathering) \
    X(bake, vertices, sbl__vertices) \
    X(bake, probes, sbl__probes)

/* What the context is doing, which decides what callbacks may call. Any callback may call sbl_progress and the query
   functions. The progress callback runs between two pieces of work, so it may also read channels. */
typedef enum sbl__inside {
    SBL__INSIDE_NOTHING, SBL__INSIDE_PROGRESS, SBL__INSIDE_WORK, SBL__INSIDE_REFUSAL
} sbl__inside;

struct sbl_context {
    sbl__core core;
#define SBL__X(verb, noun, type) type noun;
    SBL__FRONT_ENDS(SBL__X)
#undef SBL__X
    sbl__work *work;           /* the work that was begun last, finished or not; NULL if there is none */
    sbl__map *map;             /* the picture or lightmap, finished or not; NULL if there is none */
    sbl__inspection inspection;
    sbl__inside inside;
    sbl__egl egl;
};

/* What sbl__visit_enter saves for sbl__visit_leave. */
typedef struct sbl__visit { sbl__guard guard; sbl__egl before; sbl__inside inside; } sbl__visit;

/* Makes the context's own GL context current, if it has one, and saves and sets the GL state. */
static void sbl__visit_enter(sbl_context *c, sbl__visit *v) {
    v->inside = c->inside;
    c->inside = SBL__INSIDE_WORK;
    sbl__egl_enter(&c->egl, &v->before);
    sbl__guard_save(&c->core.device.gl, &v->guard);
    sbl__guard_force(&c->core.device.gl);
}

static void sbl__visit_leave(sbl_context *c, const sbl__visit *v) {
    sbl__guard_restore(&c->core.device.gl, &v->guard);
    sbl__gl_clear_errors(&c->core.device.gl);
    sbl__egl_leave(&c->egl, &v->before);
    c->inside = v->inside;
}

/* Logs why a public function refuses a call, and returns the error that the function must return. */
static sbl_result sbl__refuse(const sbl_context *c, sbl_log_item item, const char *function, const char *why) {
    sbl__log(&c->core.base, SBL_LOG_ERROR, item, "%s: %s", function, why);
    return item == SBL_LOG_ITEM_WRONG_ORDER ? SBL_ERROR_STATE : SBL_ERROR_INVALID_ARGUMENT;
}

/* Checks that a public function may be called: the context exists; it is not called by a callback, except as far as
   `most` allows (see sbl__inside); its own GL context can be made current; and, if scene is 1, there is a scene. */
static sbl_result sbl__may_call(sbl_context *c, const char *function, sbl__inside most, int scene) {
    sbl__inside inside;
    if (!c) return SBL_ERROR_INVALID_ARGUMENT;
    inside = c->inside;
    if (inside > most) {
        c->inside = SBL__INSIDE_REFUSAL;
        if (inside != SBL__INSIDE_REFUSAL)  /* a logger that calls the function again must not cause a recursion */
            sbl__refuse(c, SBL_LOG_ITEM_WRONG_ORDER, function, "called by a callback, in the middle of work; let the "
                        "callback return first (progress: return nonzero to cancel)");
        c->inside = inside;
        return SBL_ERROR_STATE;
    }
    if (!sbl__egl_ready(&c->egl)) return sbl__egl_refuse(&c->core.base, function);
    if (!scene || c->core.has_scene) return SBL_SUCCESS;
    return sbl__refuse(c, SBL_LOG_ITEM_WRONG_ORDER, function, "there is no scene yet; call sbl_set_scene first");
}

/* >>public: dropping work */

static int sbl__is_shown(const sbl_context *c, const sbl__work *work) { return c->map && work == &c->map->work; }

/* Frees work that was begun, finished or not. */
static void sbl__drop(sbl_context *c, sbl__work *work) {
    if (!work) return;
    if (sbl__is_shown(c, work)) {
        c->map = NULL;
        sbl__inspection_free(&c->core.device, &c->inspection);
    }
    work->front_end->free(work);
    if (c->work == work) c->work = NULL;
}

static void sbl__drop_all(sbl_context *c) {
    sbl__drop(c, c->work);
    if (c->map) sbl__drop(c, &c->map->work);
    sbl__job_free(&c->core.device, &c->core.job);
    sbl__bounce_end(&c->core);
}

/* Drops the work that was begun last, unless it is a finished picture or lightmap. A half-filled store stays. */
static void sbl__abandon(sbl_context *c) {
    if (c->work && !(sbl__is_shown(c, c->work) && sbl__work_is_done(c->work))) sbl__drop(c, c->work);
    sbl__job_free(&c->core.device, &c->core.job);
}

/* >>public: contexts */

/* Frees a context, which sbl_create may have failed to complete. */
static void sbl__context_free(sbl_context *c) {
    sbl__core *core = &c->core;
    sbl__base base;
    if (sbl__device_is_made(&core->device)) {
        sbl__visit visit;
        sbl__visit_enter(c, &visit);
        sbl__drop_all(c);
        sbl__scene_free(&core->device, &core->scene);
        sbl__device_free(&core->device);
        sbl__visit_leave(c, &visit);
    }
    sbl__egl_destroy(&c->egl);
    base = core->base;
    sbl__free(&base, c);
}

/* Compiles all programs that this driver can need, except those of inspections and of directional lightmaps. */
static sbl_result sbl__compile_all(sbl__device *d) {
    static const sbl__recipe *const recipes[] = {
        &sbl__recipe_visibility, &sbl__recipe_gbuffer, &sbl__recipe_trace, &sbl__recipe_cast, &sbl__recipe_lamps,
        &sbl__recipe_sensor, &sbl__recipe_sky, &sbl__recipe_reduce_blocks, &sbl__recipe_reduce_sum,
        &sbl__recipe_filter, &sbl__recipe_resolve, &sbl__recipe_copy
    };
    const unsigned varied = SBL__TEXTURED | SBL__CUTOUTS | SBL__VIEWS | SBL__MIXED | SBL__BOUNCED | SBL__GUIDED |
                            SBL__LIGHTMAP | SBL__DISPLAY;
    sbl_result result = SBL_SUCCESS;
    unsigned features;
    int i;
    for (i = 0; i < SBL__COUNT(recipes); i++)
        for (features = 0; features <= varied && result == SBL_SUCCESS; features++) {
            if (features & ~(varied & recipes[i]->features)) continue;
            if (features & SBL__CUTOUTS && recipes[i]->features & ~features & SBL__TEXTURED) continue;
            result = sbl__program_need(d, recipes[i], features);
        }
    if (result == SBL_SUCCESS)
        sbl__log(d->base, SBL_LOG_INFO, SBL_LOG_ITEM_INFO, "%d programs were compiled in %.3f s", d->compiled.count,
                 d->compiled.compile_seconds);
    return result;
}

SBL_API sbl_result sbl_create(const sbl_context_desc *desc, sbl_context **out) {
    sbl_context_desc d = sbl_context_desc_defaults(desc);
    sbl__egl before;
    sbl__visit visit;
    sbl__base base;
    sbl_context *c;
    sbl_result result;
    memset(&base, 0, sizeof base);
    memset(&before, 0, sizeof before);
    base.allocator = d.allocator;
    base.logger = d.logger;
    if (!out) {
        sbl__log(&base, SBL_LOG_ERROR, SBL_LOG_ITEM_INVALID_ARGUMENT,
                 "sbl_create: out is NULL; it receives the context");
        return SBL_ERROR_INVALID_ARGUMENT;
    }
    *out = NULL;
    result = sbl__check_context(&base, &d);
    if (result != SBL_SUCCESS) return result;
    c = (sbl_context *)sbl__alloc(&base, 1, sizeof *c);
    if (!c) return SBL_ERROR_OUT_OF_MEMORY;
    c->core.base = base;
    c->core.desc = d;
    c->core.device.base = c->core.device.gl.base = &c->core.base;
    if (!d.get_gl_function) result = sbl__egl_open(&c->egl, &c->core.base, &before, &d);
    if (result == SBL_SUCCESS) result = sbl__device_make(&c->core.device, &d);
    if (result == SBL_SUCCESS) {
        sbl__visit_enter(c, &visit);
        if (d.compile_ahead) result = sbl__compile_all(&c->core.device);
        if (result == SBL_SUCCESS) result = sbl__trial(&c->core);
        sbl__visit_leave(c, &visit);
    }
    sbl__egl_leave(&c->egl, &before);
    if (result == SBL_SUCCESS) *out = c;
    else sbl__context_free(c);
    return result;
}

SBL_API void sbl_destroy(sbl_context *c) {
    if (sbl__may_call(c, "sbl_destroy", SBL__INSIDE_NOTHING, 0) == SBL_SUCCESS) sbl__context_free(c);
}

/* >>public: scenes */

SBL_API sbl_result sbl_set_scene(sbl_context *c, const sbl_scene_desc *desc) {
    const double start = sbl__now();
    sbl__scene scene;
    sbl__visit visit;
    sbl_result result = sbl__may_call(c, "sbl_set_scene", SBL__INSIDE_NOTHING, 0);
    if (result != SBL_SUCCESS) return result;
    if (!desc) return sbl__refuse(c, SBL_LOG_ITEM_INVALID_ARGUMENT, "sbl_set_scene", "desc is NULL");
    memset(&scene, 0, sizeof scene);
    sbl__visit_enter(c, &visit);
    result = sbl__scene_make(&c->core.device, &scene, desc);
    if (result == SBL_SUCCESS) {
        sbl__scene_warn(&c->core.base, &scene);
        sbl__abandon(c);
        sbl__bounce_end(&c->core);
        scene.version = c->core.scene.version + 1;
        scene.surfaces = c->core.scene.surfaces + 1;
        sbl__scene_free(&c->core.device, &c->core.scene);
        c->core.scene = scene;
        c->core.has_scene = 1;
        if (!c->work && !c->map) memset(&c->core.stats, 0, sizeof c->core.stats);
        c->core.stats.scene.triangles = scene.geometry.triangle_count;
        c->core.stats.seconds.scene = sbl__now() - start;
    }
    sbl__visit_leave(c, &visit);
    return result;
}

/* Replaces the materials or the lights. desc: has only one of them; the pointer to the other is NULL */
static sbl_result sbl__update_light(sbl_context *c, const char *function, const sbl_scene_desc *desc) {
    const char *what = desc->materials ? "materials" : "lights";
    const int count = desc->materials ? desc->material_count : desc->light_count;
    sbl__visit visit;
    sbl__check check = { NULL, NULL, SBL_LOG_ITEM_INVALID_ARGUMENT, "", 0 };
    sbl_result result = sbl__may_call(c, function, SBL__INSIDE_NOTHING, 1);
    int i, has;
    if (result != SBL_SUCCESS) return result;
    snprintf(check.where, sizeof check.where, "%s", function);
    has = desc->materials ? c->core.scene.material_count : c->core.scene.lights.count;
    check.base = &c->core.base;
    if (count != has) sbl__mistake(&check, "%d %s are given; the scene has %d", count, what, has);
    for (i = 0; i < count && count == has; i++) {
        if (desc->materials) sbl__check_material(&check, desc, i);
        else sbl__check_light(&check, &desc->lights[i], i);
    }
    if (check.mistakes) return SBL_ERROR_INVALID_ARGUMENT;
    sbl__visit_enter(c, &visit);
    sbl__abandon(c);
    result = sbl__scene_update_light(&c->core.device, &c->core.scene, desc->materials, desc->lights);
    sbl__visit_leave(c, &visit);
    return result;
}

SBL_API sbl_result sbl_set_materials(sbl_context *c, const sbl_material *materials, int material_count) {
    sbl_material none;
    sbl_scene_desc desc;
    memset(&none, 0, sizeof none);
    memset(&desc, 0, sizeof desc);
    desc.materials = materials ? materials : &none;
    desc.material_count = materials ? material_count : 0;
    desc.texture_count = c ? c->core.scene.textures.count : 0;
    return sbl__update_light(c, "sbl_set_materials", &desc);
}

SBL_API sbl_result sbl_set_lights(sbl_context *c, const sbl_light *lights, int light_count) {
    sbl_scene_desc desc;
    memset(&desc, 0, sizeof desc);
    desc.lights = lights;
    desc.light_count = lights ? light_count : 0;
    return sbl__update_light(c, "sbl_set_lights", &desc);
}

SBL_API sbl_result sbl_save_store(sbl_context *c, sbl_write_function put, void *user) {
    const sbl_result result = put ? sbl__may_call(c, "sbl_save_store", SBL__INSIDE_NOTHING, 1)
                                  : SBL_ERROR_INVALID_ARGUMENT;
    if (result != SBL_SUCCESS) return result;
    if (!c->core.scene.store.ready)
        return sbl__refuse(c, SBL_LOG_ITEM_WRONG_ORDER, "sbl_save_store", "no light is stored; render or gather in "
                           "SBL_MODE_GI first");
    if (sbl__saved_write(&c->core.scene, put, user)) return SBL_SUCCESS;
    return sbl__refuse(c, SBL_LOG_ITEM_INVALID_STORE, "sbl_save_store", "put took fewer bytes than it was given");
}

SBL_API sbl_result sbl_load_store(sbl_context *c, sbl_read_function get, void *user) {
    sbl__visit visit;
    sbl_result result = get ? sbl__may_call(c, "sbl_load_store", SBL__INSIDE_NOTHING, 1) : SBL_ERROR_INVALID_ARGUMENT;
    if (result != SBL_SUCCESS) return result;
    sbl__visit_enter(c, &visit);
    sbl__abandon(c);
    result = sbl__saved_load(&c->core, get, user);
    sbl__visit_leave(c, &visit);
    return result;
}

SBL_API sbl_result sbl_set_mesh_transform(sbl_context *c, int mesh, const float transform[16]) {
    float to[16];
    sbl__visit visit;
    sbl__check check = { NULL, NULL, SBL_LOG_ITEM_INVALID_ARGUMENT, "sbl_set_mesh_transform", 0 };
    sbl_result result = sbl__may_call(c, "sbl_set_mesh_transform", SBL__INSIDE_NOTHING, 1);
    if (result != SBL_SUCCESS) return result;
    check.base = &c->core.base;
    if (mesh < 0 || mesh >= c->core.scene.geometry.mesh_count)
        sbl__mistake(&check, "mesh is %d; the scene has %d", mesh, c->core.scene.geometry.mesh_count);
    if (!transform) sbl__mistake(&check, "transform is NULL");
    sbl__check_object(&check, SBL_LOG_ITEM_INVALID_MESH, "mesh", mesh);
    if (transform) sbl__check_transform(&check, transform);
    if (check.mistakes) return SBL_ERROR_INVALID_ARGUMENT;
    if (sbl__all_zero(transform, 16)) sbl__identity(to);
    else memcpy(to, transform, sizeof to);
    sbl__visit_enter(c, &visit);
    result = sbl__scene_move(&c->core.device, &c->core.scene, mesh, to);
    if (result != SBL_ERROR_INVALID_ARGUMENT) {
        sbl__abandon(c);
        sbl__bounce_end(&c->core);
    }
    sbl__visit_leave(c, &visit);
    return result;
}

/* >>public: begin, step, end */

/* Checks desc, drops former work, and begins work. work: the front end's struct in the context */
static sbl_result sbl__begin(sbl_context *c, void *work, const sbl__front_end *f, const void *desc) {
    const double start = sbl__now();
    sbl__measurement measurement;
    sbl__visit visit;
    sbl_result result = sbl__may_call(c, f->begin_name, SBL__INSIDE_NOTHING, 1);
    if (result == SBL_SUCCESS) result = f->check(&c->core, desc, &measurement);
    if (result != SBL_SUCCESS) return result;
    measurement.options.backend = sbl__choose_backend(&measurement, &c->core.scene);
    sbl__visit_enter(c, &visit);
    sbl__abandon(c);
    if (f->is_map && c->map) sbl__drop(c, &c->map->work);
    sbl__core_begin(&c->core, &measurement);
    c->work = (sbl__work *)work;
    if (f->is_map) c->map = (sbl__map *)work;
    result = sbl__work_begin(c->work, f, &c->core, &measurement, desc);
    if (result != SBL_SUCCESS) sbl__abandon(c);
    sbl__visit_leave(c, &visit);
    c->core.stats.seconds.total = sbl__now() - start;
    return result;
}

#define SBL__X(verb, noun, type) \
    SBL_API sbl_result sbl_begin_##noun(sbl_context *c, const sbl_##noun##_desc *desc) { \
        return sbl__begin(c, c ? &c->noun : NULL, &sbl__##noun##_front_end, desc); \
    } \
    SBL_API sbl_result sbl_##verb##_##noun(sbl_context *c, const sbl_##noun##_desc *desc) { \
        const sbl_result result = sbl_begin_##noun(c, desc); \
        return result == SBL_SUCCESS ? sbl_step(c, 0) : result; \
    }
SBL__FRONT_ENDS(SBL__X)
#undef SBL__X

/* Does one piece of the work, then calls the progress callback. */
static sbl_result sbl__context_step(sbl_context *c, sbl__slice *slice) {
    sbl__core *core = &c->core;
    sbl__work *w = c->work;
    const sbl_options *o = &w->measurement.options;
    const double start = sbl__now();
    sbl_result result = sbl__work_step(w, slice);
    const sbl_result errors = sbl__gl_check(&core->device.gl);
    float own;
    core->stats.seconds.total += sbl__now() - start;
    own = w->front_end->progress(w);
    w->progress = SBL__MAX(w->progress, w->store_share * sbl__bounce_progress(core) + (1 - w->store_share) * own);
    w->progress_at = core->stats.seconds.total;
    if (errors != SBL_SUCCESS && (result == SBL_SUCCESS || result == SBL_UNFINISHED)) result = errors;
    if ((result != SBL_SUCCESS && result != SBL_UNFINISHED) || !o->progress) return result;
    c->inside = SBL__INSIDE_PROGRESS;
    if (o->progress(w->progress, o->progress_user)) result = SBL_CANCELLED;
    c->inside = SBL__INSIDE_WORK;
    return result;
}

#define SBL__SLICE_REST 0.2  /* a slice ends when less than this share of its time is left */

SBL_API sbl_result sbl_step(sbl_context *c, double seconds) {
    sbl__slice slice;
    sbl__visit visit;
    sbl_result result = sbl__may_call(c, "sbl_step", SBL__INSIDE_NOTHING, 0);
    double last;
    if (result != SBL_SUCCESS) return result;
    if (!c->work)
        return sbl__refuse(c, SBL_LOG_ITEM_WRONG_ORDER, "sbl_step", "nothing was begun, or it was dropped; call "
                           "sbl_begin_picture or another function that begins work");
    if (sbl__work_is_done(c->work)) return SBL_SUCCESS;
    slice = sbl__slice_of(&c->core.desc, seconds);
    last = seconds > 0 ? slice.end - SBL__SLICE_REST * seconds : DBL_MAX;
    sbl__visit_enter(c, &visit);
    do result = sbl__context_step(c, &slice);
    while (result == SBL_UNFINISHED && sbl__now() < last);
    if (c->core.stats.sensors.count)
        c->core.stats.sensors.microseconds = 1e6 * c->core.stats.seconds.total / (double)c->core.stats.sensors.count;
    if (result != SBL_SUCCESS && result != SBL_UNFINISHED) {
        sbl__drop(c, c->work);  /* also a finished picture, if the progress callback cancels after the last piece */
        sbl__job_free(&c->core.device, &c->core.job);
        if (!c->core.scene.store.ready) sbl__bounce_end(&c->core);
    }
    sbl__visit_leave(c, &visit);
    return result;
}

SBL_API float sbl_progress(const sbl_context *c) { return c && c->work ? c->work->progress : 0; }

SBL_API void sbl_end(sbl_context *c) {
    sbl__visit visit;
    if (!c || (!c->work && !c->map) || sbl__may_call(c, "sbl_end", SBL__INSIDE_NOTHING, 0) != SBL_SUCCESS) return;
    sbl__visit_enter(c, &visit);
    sbl__drop_all(c);
    sbl__visit_leave(c, &visit);
}

/* >>public: channels */

SBL_API int sbl_channel_components(sbl_channel channel) {
    return (int)channel >= 0 && channel < SBL_CHANNEL_COUNT ? sbl__channels[channel].components : 0;
}

/* Makes a preview if the map is not finished. SBL_SUCCESS: channels can be read; SBL_UNFINISHED: it is too early. */
static sbl_result sbl__channel_ready(sbl_context *c, const char *function) {
    sbl__visit visit;
    sbl_result result;
    if (!c->map)
        return sbl__refuse(c, SBL_LOG_ITEM_WRONG_ORDER, function, "there is no picture; call sbl_render_picture, or "
                           "sbl_begin_picture and sbl_step");
    if (sbl__work_is_done(&c->map->work)) return SBL_SUCCESS;
    sbl__visit_enter(c, &visit);
    result = sbl__map_watch(c->map);
    if (result != SBL_SUCCESS && result != SBL_UNFINISHED && visit.inside == SBL__INSIDE_NOTHING) sbl__abandon(c);
    sbl__visit_leave(c, &visit);
    return result;
}

SBL_API sbl_result sbl_read_channel(sbl_context *c, sbl_channel channel, float *out, size_t float_count) {
    const int components = sbl_channel_components(channel);
    sbl__visit visit;
    sbl__check check = { NULL, NULL, SBL_LOG_ITEM_INVALID_ARGUMENT, "sbl_read_channel", 0 };
    size_t pixels;
    sbl_result result = sbl__may_call(c, "sbl_read_channel", SBL__INSIDE_PROGRESS, 0);
    if (result != SBL_SUCCESS) return result;
    check.base = &c->core.base;
    pixels = c->map ? (size_t)c->map->size[0] * (size_t)c->map->size[1] : 0;
    if (!components || !out)
        sbl__mistake(&check, "channel is %d (0 to %d exist), out is %s", (int)channel, SBL_CHANNEL_COUNT - 1,
                     out ? "given" : "NULL");
    else if (float_count < pixels * (size_t)components)
        sbl__mistake(&check, "float_count is %.0f; channel %d of %d x %d pixels needs %.0f floats",
                     (double)float_count, (int)channel, c->map->size[0], c->map->size[1], (double)pixels * components);
    if (check.mistakes) return SBL_ERROR_INVALID_ARGUMENT;
    result = sbl__channel_ready(c, "sbl_read_channel");
    if (result != SBL_SUCCESS) return result;
    sbl__visit_enter(c, &visit);
    result = sbl__map_read_channel(c->map, channel, out);
    sbl__visit_leave(c, &visit);
    return result;
}

SBL_API uint32_t sbl_channel_texture(sbl_context *c, sbl_channel channel) {
    sbl__visit visit;
    uint32_t texture;
    if (!c || !c->map || !sbl_channel_components(channel) ||
        sbl__may_call(c, "sbl_channel_texture", SBL__INSIDE_PROGRESS, 0) != SBL_SUCCESS ||
        sbl__channel_ready(c, "sbl_channel_texture") != SBL_SUCCESS) return 0;
    sbl__visit_enter(c, &visit);
    texture = sbl__map_channel_texture(c->map, channel);
    sbl__visit_leave(c, &visit);
    return texture;
}

/* >>public: inspection */

SBL_API sbl_result sbl_inspect_sensor(sbl_context *c, int x, int y, sbl_sensor *sensor, float *radiance, float *weights,
                                      size_t texel_count) {
    sbl__inspect_request request;
    sbl__visit visit;
    sbl_result result = sbl__may_call(c, "sbl_inspect_sensor", SBL__INSIDE_NOTHING, 0);
    if (result != SBL_SUCCESS) return result;
    memset(&request, 0, sizeof request);
    request.core = &c->core;
    request.map = c->map;
    request.found = &c->inspection;
    request.radiance = radiance;
    request.weights = weights;
    result = sbl__inspect_check(&request, x, y, sensor, texel_count);
    if (result != SBL_SUCCESS) return result;
    sbl__inspection_clear(&c->core.base, &c->inspection);
    sbl__visit_enter(c, &visit);
    result = sbl__inspect(&request);
    sbl__visit_leave(c, &visit);
    if (result == SBL_SUCCESS) *sensor = request.out;
    else sbl__inspection_clear(&c->core.base, &c->inspection);
    return result;
}

/* >>public: helpers */

SBL_API int sbl_look_at(float world_to_view[16], float eye_x, float eye_y, float eye_z, float at_x, float at_y,
                        float at_z, float up_x, float up_y, float up_z) {
    const double eye[3] = { eye_x, eye_y, eye_z };
    double f[3] = { at_x - eye[0], at_y - eye[1], at_z - eye[2] }, u[3] = { up_x, up_y, up_z }, r[3];
    float m[16];
    int k;
    if (!sbl__normalize(f) || !sbl__normalize(u)) return 0;
    sbl__cross(f, u, r);
    if (r[0] * r[0] + r[1] * r[1] + r[2] * r[2] < 1e-12 || !sbl__normalize(r)) return 0;
    sbl__cross(r, f, u);
    for (k = 0; k < 3; k++) {
        m[4 * k] = (float)r[k];
        m[4 * k + 1] = (float)u[k];
        m[4 * k + 2] = (float)-f[k];
        m[4 * k + 3] = 0;
    }
    m[12] = (float)-(r[0] * eye[0] + r[1] * eye[1] + r[2] * eye[2]);
    m[13] = (float)-(u[0] * eye[0] + u[1] * eye[1] + u[2] * eye[2]);
    m[14] = (float)(f[0] * eye[0] + f[1] * eye[1] + f[2] * eye[2]);
    m[15] = 1;
    if (!sbl__all_finite(m, 16)) return 0;
    memcpy(world_to_view, m, sizeof m);
    return 1;
}

SBL_API int sbl_perspective(float m[16], float fov_y, float aspect) {
    const double t = tan(0.5 * fov_y * SBL__PI / 180);
    const float wide = (float)(1 / (t * aspect)), high = (float)(1 / t);
    if (!sbl__between(&fov_y, FLT_MIN, 180) || fov_y >= 180 || !sbl__between(&aspect, FLT_MIN, FLT_MAX)) return 0;
    if (!sbl__between(&wide, FLT_MIN, FLT_MAX) || !sbl__between(&high, FLT_MIN, FLT_MAX)) return 0;
    memset(m, 0, 16 * sizeof(float));
    m[0] = wide;
    m[5] = high;
    m[10] = -1;
    m[11] = -1;
    m[14] = -0.2f;  /* the near plane is at 0.1, and there is no far plane; sbl.h itself ignores both */
    return 1;
}

SBL_API void sbl_encode_srgb8(unsigned char *out, const float *linear, size_t float_count, float scale) {
    size_t i;
    for (i = 0; i < float_count; i++) {
        const int infinite = sbl__float_bits(&linear[i]) == 0x7f800000u;
        const double x = infinite ? 1 : sbl__finite(&linear[i]) ? (double)linear[i] * (double)scale : 0;
        const double y = !(x > 0) ? 0 : x >= 1 ? 1 : x <= 0.0031308 ? 12.92 * x : 1.055 * pow(x, 1 / 2.4) - 0.055;
        out[i] = (unsigned char)(255 * y + 0.5);
    }
}

/* >>public: queries */

/* Functions that return a struct of the context, or all zeroes without a context. */
#define SBL__QUERIES(X) \
    X(sbl_context_desc, sbl_query_desc, c->core.desc) \
    X(sbl_capabilities, sbl_query_capabilities, c->core.device.gl.capabilities) \
    X(sbl_stats, sbl_query_stats, c->core.stats) \
    X(sbl_memory, sbl_query_memory, c->core.base.memory) \
    X(sbl_programs, sbl_query_programs, c->core.device.compiled)
#define SBL__X(type, function, value) \
    SBL_API type function(const sbl_context *c) { \
        type none; \
        memset(&none, 0, sizeof none); \
        return c ? value : none; \
    }
SBL__QUERIES(SBL__X)
#undef SBL__X

SBL_API sbl_bounds sbl_query_bounds(const sbl_context *c) {
    sbl_bounds bounds;
    memset(&bounds, 0, sizeof bounds);
    if (!c || !c->core.has_scene) return bounds;
    memcpy(bounds.lowest, c->core.scene.geometry.bounds[0], sizeof bounds.lowest);
    memcpy(bounds.highest, c->core.scene.geometry.bounds[1], sizeof bounds.highest);
    return bounds;
}

SBL_API const char *sbl_version(void) { return "0.2.0"; }

SBL_API const char *sbl_result_string(sbl_result result) {
    static const char *const words[SBL_RESULT_COUNT] = {
        "success", "unfinished: call sbl_step again", "cancelled by the progress callback", "invalid argument",
        "out of memory", "unsupported by the GL context or this version", "called in the wrong order", "GL error"
    };
    return (int)result >= 0 && result < SBL_RESULT_COUNT ? words[result] : "unknown result";
}

SBL_API const char *sbl_log_item_string(sbl_log_item item) {
#define SBL__X(name, text) text,
    static const char *const words[SBL_LOG_ITEM_COUNT] = { SBL_LOG_ITEMS(SBL__X) };
#undef SBL__X
    return (int)item >= 0 && item < SBL_LOG_ITEM_COUNT ? words[item] : "unknown log item";
}

#endif /* SBL_IMPLEMENTATION_INCLUDED */
#endif /* SBL_IMPLEMENTATION */
