// The form of scene.method, the title, and other facts on which schema defaults depend.
#include "deck.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <set>

namespace rk {

// Default number of cells across the thinnest direction of a body, and maximum in any other one, by
// space dimension: the start of a search for points; half of them still resolve the body
constexpr int first_cells[] = {8, 8, 6}, most_first_cells[] = {64, 64, 24};
// Default error aimed at by the search
constexpr double usual_accuracy = 0.02;

static bool plane_gauss(const Deck &deck) {
   return deck.word("scene", "method") == "rkpm-gauss" && deck.dimension() == 2;
}

// With a basis of order 1 the forces of annuli need eight times as many points for the same error.
// It needs three points across the wall. In boxes functions of order 1 run out as parabolas at the
// sides, and order 2 gains nothing.
static bool asks_order_two(Deck &deck) {
   const Section *geometry = deck.single("geometry");
   if (!plane_gauss(deck) || !geometry || geometry->text("kind") != "annulus" ||
       deck.value("approximation", "order") || deck.value("approximation", "support"))
      return false;
   const Value *source = geometry->find("source");
   return source && source->items.size() == 2 && source->items[0].number() >= 3.0 &&
          source->items[1].number() >= 3.0;
}

// Such a basis needs a wider and smoother kernel: with support 2.5 and the cubic spline there are
// modes near corners that two Gauss points hardly resist. Where a wall of the tube meets a plane of
// symmetry they put the stress 20 % off, at any number of points.
static bool plane_quadratic(Deck &deck) {
   const Value *order = deck.value("approximation", "order");
   if (deck.value("approximation", "support"))
      return false;
   return plane_gauss(deck) && (order ? order->integer == 2 : deck.facts.count("order_two"));
}

// States before full load are needed if reference values are given for them
static bool compares_on_the_way(Deck &deck) {
   const Value *full = deck.value("load", "activation");
   for (const Section *reference : deck.entries("reference")) {
      const Value *shares = reference->find("load"), *levels = reference->find("activation");
      for (const Value &share : shares ? shares->items : std::vector<Value>{}) {
         if (share.number() < 1.0)
            return true;
      }
      for (const Value &level : levels ? levels->items : std::vector<Value>{}) {
         if (full && level.number() < full->number())
            return true;
      }
   }
   return false;
}

void put_default(Section &section, const std::string &key, Value value) {
   value.origin = section.origin;
   value.by_default = true;
   section.values[key] = std::move(value);
}

// Lengths of a body along the directions of its lattice; empty if they are unknown
static std::vector<double> lengths(const Section &geometry) {
   // refused values give no information
   if (geometry.text("kind") == "model" || !geometry.refused.empty())
      return {};
   if (geometry.text("kind") == "annulus") {
      const Value *inner = geometry.find("inner_radius"), *outer = geometry.find("outer_radius");
      if (!inner || !outer || outer->number() <= inner->number())
         return {};
      return {outer->number() - inner->number(),
              std::atan(1.0) * (outer->number() + inner->number())};
   }
   std::vector<double> found;
   if (const Value *size = geometry.find("size")) {
      for (const Value &item : size->items)
         found.push_back(item.number());
   }
   return found;
}

// Default source points: cells of about equal lengths in all directions, an even number of them,
// since pairs share their pressures; a plate has no more in total than a bar
static bool first_points(Section &geometry, int dimension) {
   const std::vector<double> size = lengths(geometry);
   if (size.empty() || size.size() != std::size_t(dimension) || geometry.find("source"))
      return false;
   const double least = *std::min_element(size.begin(), size.end());
   const double fewest = first_cells[size.size() - 1], most = most_first_cells[size.size() - 1];
   const double in_all = most * std::pow(fewest, size.size() - 1.0);
   std::vector<double> cells;
   double share = 1.0, product;
   do {
      cells.clear();
      product = 1.0;
      for (double length : size) {
         cells.push_back(std::clamp(share * fewest * length / least, fewest, most));
         product *= cells.back();
      }
      share *= 0.99;
   } while (product > 1.001 * in_all);
   std::vector<std::int64_t> source;
   for (double number : cells)
      source.push_back(1 + 2 * std::llround(0.5 * number));
   put_default(geometry, "source", {source, geometry.origin});
   return true;
}

// Sides of a box at which motions along them are prescribed, and adjacent sides that are neither
// clamped nor planes of symmetry: stress is singular along their common edges
static std::vector<std::string> singular_sides(Deck &deck, std::size_t dimension) {
   const std::string axes = "xyz";
   std::set<std::string> clamped, guided;
   for (const Section *entry : deck.entries("boundary")) {
      std::string side = entry->text("set");
      for (const Section *part : deck.entries("set")) {
         if (part->text("name") == side)
            side = part->text("side");
      }
      if (side.size() != 2 || axes.find(side[0]) >= dimension)
         continue;
      for (std::size_t axis = 0; axis < dimension; axis++) {
         const bool across = side[0] == axes[axis];
         if (entry->find("rotation") || entry->find(std::string("u_") + axes[axis]))
            (across ? guided : clamped).insert(side);
      }
   }
   std::set<std::string> sides = clamped;
   for (const std::string &held : clamped) {
      for (std::size_t axis = 0; axis < dimension; axis++) {
         for (const char end : {'0', '1'}) {
            const std::string side = {axes[axis], end};
            if (axes[axis] != held[0] && !guided.count(side))
               sides.insert(side);
         }
      }
   }
   return {sides.begin(), sides.end()};
}

// Twice as many output points, or points of equations, as cells
static void first_places(Section &geometry) {
   const Value *source = geometry.find("source");
   if (!source || geometry.find("collocation") || !geometry.refused.empty())
      return;
   std::vector<std::int64_t> places;
   for (const Value &item : source->items)
      places.push_back(2 * item.integer - 1);
   put_default(geometry, "collocation", {places, geometry.origin});
}

// The table of the search: for decks that ask for an error, and for those with default points
static void ask_for_error(Deck &deck, bool chosen_here) {
   if (deck.entries("refine").empty()) {
      const Value *asked = deck.value("", "accuracy");
      if (!chosen_here && !asked)
         return;
      deck.add(*find_table("refine"), asked ? asked->origin : deck.single("geometry")->origin);
   }
   Section &refine = *deck.entries("refine").front();
   for (const char *key : {"accuracy", "cost"}) {
      if (refine.given(key))
         continue;
      if (const Value *value = deck.value("", key))
         refine.values[key] = *value;
   }
   if (!refine.given("accuracy"))
      put_default(refine, "accuracy", Value(usual_accuracy));
}

// Whether source points on the sides can carry prescribed displacements. Not if the penalty is
// needed (unfactorised tangents), used (tendons, pressures) or set in the deck. The border of a
// part of a side lies between two points: only the penalty resolves it.
static bool can_hold(Deck &deck) {
   if (deck.value("galerkin", "penalty") || deck.value("galerkin", "direct_limit"))
      return false;
   std::set<std::string> parts;
   for (const Section *entry : deck.entries("set"))
      if (entry->find("where") || entry->find("on"))
         parts.insert(entry->text("name"));
   const std::vector<Section *> entries = deck.entries("boundary");
   return std::none_of(entries.begin(), entries.end(), [&parts](const Section *entry) {
      const bool held = entry->find("u_x") || entry->find("u_y") || entry->find("u_z") ||
                        entry->find("radial") || entry->find("rotation");
      return entry->find("tendon") || entry->find("pressure") ||
             (held && parts.count(entry->text("set")));
   });
}

// Default points are improved by a search if one is possible
static void choose_points(Deck &deck) {
   const std::vector<Section *> bodies = deck.entries("geometry");
   if (bodies.empty() || bodies.front()->refused.count("kind"))
      return;
   const bool chosen_here = first_points(*bodies.front(), deck.dimension());
   first_places(*bodies.front());
   const bool gauss = deck.word("scene", "method") == "rkpm-gauss";
   const bool nonlinear = gauss && !deck.single("linear");
   Section &body = *bodies.front();
   // an interface inside the body needs refinement there as well
   if (chosen_here && nonlinear && body.text("kind") == "box" && !body.given("graded") &&
       deck.entries("material").size() == 1) {
      const std::vector<std::string> sides =
          singular_sides(deck, body.find("source")->items.size());
      put_default(body, "graded", {sides, body.origin});
   }
   // with a known solution, or a stable time step, the default points are not searched
   const bool searched = chosen_here && gauss && !deck.entries("probe").empty() &&
                         !deck.value("linear", "exact") && !deck.single("dynamics");
   if (searched && nonlinear && can_hold(deck))
      deck.facts["points_chosen"] = "true";
   ask_for_error(deck, searched);
}

void choose_form(Deck &deck) {
   // for conditions of nonlinear decks
   if (!deck.single("linear"))
      deck.facts["linear.problem"] = "none";
   const std::vector<Section *> scenes = deck.entries("scene");
   if (scenes.empty() || scenes.front()->refused.count("method"))
      return;
   Section &scene = *scenes.front();
   Value method;
   method.origin = scene.origin;
   if (const Value *given = scene.find("method"))
      method = *given;
   if (method.text.empty() || method.text == "auto")
      // Gauss points need cells between source points (lattice, voxels); nodal cells do not
      method.text = deck.single("geometry") ? "rkpm-gauss" : "rkpm-scni";
   if (method.text == "rkpm")
      method.text = "rkpm-scni";
   scene.values["method"] = method;
   // this may add a table, which moves the others
   choose_points(deck);
   if (asks_order_two(deck))
      deck.facts["order_two"] = "true";
   if (plane_quadratic(deck))
      deck.facts["plane_quadratic"] = "true";
   if (compares_on_the_way(deck))
      deck.facts["compared_on_the_way"] = "true";
}

void choose_title(Deck &deck) {
   Section &top = deck.sections.front();
   if (top.given("title"))
      return;
   // a file name may contain characters that a text of a deck must not
   const std::string stem = std::filesystem::path(deck.name).stem().string();
   std::optional<Value> title = parse_value("'''" + stem + "'''");
   if (!title || is_blank(title->text))
      title = parse_value("'scene'");
   put_default(top, "title", *title);
}

} // namespace rk
