// Decks for rk_deck.f90: a view of the deck with a flat list of entries, in the order of the schema.
//
// Entry kinds: 0 table, 1 text, 2 texts (a line each), 3 number, 4 integer, 5 boolean (0 or 1),
// 6 numbers, 7 integers, 8 array of tables (with their number; they follow). A text that names an
// entry of another table has the number of that entry, from 1, beside it. All pointers live
// until rk_deck_close.
#include "deck.h"

#include <algorithm>
#include <iomanip>
#include <numeric>
#include <sstream>

extern "C" {

// The same as entry_view and deck_view in rk_deck.f90
struct EntryView {
   const char *key, *where, *address, *text;
   const double *numbers;
   int count, kind, sorted; // the last: the entry (from 0) that has this place by its key
};

struct DeckView {
   const char *message, *name, *text, *sha256, *folder;
   const EntryView *entries;
   int count, status;
};

} // extern "C"

namespace {

struct Entry {
   std::string key, where, address, text;
   int kind = 0;
   std::vector<double> numbers;
};

struct Flat : DeckView {
   rk::Deck deck;
   std::vector<Entry> entries;
   std::map<std::string, std::map<std::string, int>> numbers; // of entries, by table and name
   std::vector<EntryView> views;
};

// Expressions among numbers
bool has_text(const rk::Value &value) {
   return std::any_of(value.items.begin(), value.items.end(), [](const rk::Value &item) {
      return item.kind == rk::Value::Kind::text;
   });
}

// All digits, which Value::plain cuts for messages
std::string exactly(double number) {
   std::ostringstream text;
   text << std::setprecision(17) << number;
   return text.str();
}

int kind_of(const rk::KeySpec &spec, const rk::Value &value) {
   switch (spec.type) {
   case rk::Type::text:
      return value.is_number() ? 3 : 1;
   case rk::Type::texts:
      return 2;
   case rk::Type::number:
      return value.is_number() ? 3 : 1;
   case rk::Type::integer:
      return 4;
   case rk::Type::boolean:
      return 5;
   case rk::Type::numbers:
      return has_text(value) ? 2 : 6;
   default:
      return 7;
   }
}

Entry flatten(const rk::Value &value) {
   Entry entry;
   if (value.is_number())
      entry.numbers = {value.number()};
   if (value.kind == rk::Value::Kind::boolean)
      entry.numbers = {value.boolean ? 1.0 : 0.0};
   if (value.kind == rk::Value::Kind::text)
      entry.text = value.text;
   const bool as_text = has_text(value);
   for (const rk::Value &item : value.items) {
      if (item.is_number() && as_text)
         entry.text += exactly(item.number()) + "\n";
      else if (item.is_number())
         entry.numbers.push_back(item.number());
      else
         entry.text += item.text + "\n";
   }
   return entry;
}

void add_section(Flat &flat, const rk::Section &section) {
   std::string prefix = section.spec->name;
   if (section.spec->many)
      prefix += "." + std::to_string(section.index);
   if (!prefix.empty()) {
      Entry table;
      table.key = prefix;
      table.where = flat.deck.where(section.origin);
      table.address = flat.deck.address(section);
      flat.entries.push_back(table);
   }
   for (const rk::KeySpec &spec : section.spec->keys) {
      const rk::Value *value = section.find(spec.name);
      if (!value)
         continue;
      Entry entry = flatten(*value);
      if (!spec.refers_to.empty())
         entry.numbers = {static_cast<double>(flat.numbers[spec.refers_to][value->text])};
      entry.key = prefix.empty() ? spec.name : prefix + "." + spec.name;
      // empty: nobody wrote it
      entry.where = value->by_default ? "" : flat.deck.where(value->origin);
      entry.address = flat.deck.address(section, spec.name);
      entry.kind = kind_of(spec, *value);
      flat.entries.push_back(entry);
   }
}

// Say anew what the deck and its entries are
void look(Flat &flat) {
   std::vector<int> sorted(flat.entries.size());
   std::iota(sorted.begin(), sorted.end(), 0);
   const auto key = [&flat](int i) -> const std::string & {
      return flat.entries[static_cast<std::size_t>(i)].key;
   };
   std::sort(sorted.begin(), sorted.end(), [&key](int one, int other) { return key(one) < key(other); });
   flat.views.clear();
   for (const Entry &entry : flat.entries)
      flat.views.push_back({entry.key.c_str(), entry.where.c_str(), entry.address.c_str(), entry.text.c_str(),
                            entry.numbers.data(), static_cast<int>(entry.numbers.size()), entry.kind,
                            sorted[flat.views.size()]});
   const rk::Deck &deck = flat.deck;
   static_cast<DeckView &>(flat) = {
      deck.message.c_str(), deck.name.c_str(), deck.text.c_str(), deck.sha256.c_str(), deck.folder.c_str(),
      flat.views.data(), static_cast<int>(flat.views.size()), static_cast<int>(deck.status)};
}

void fill(Flat &flat) {
   for (const rk::Section &section : flat.deck.sections) {
      if (!section.spec->named_by.empty())
         flat.numbers[section.spec->name][section.text(section.spec->named_by)] = section.index;
   }
   for (const rk::TableSpec &spec : rk::schema()) {
      // of a refused deck a summary has the units and the method
      if (spec.many && flat.deck.status != rk::Status::good)
         continue;
      const std::vector<rk::Section *> sections = flat.deck.entries(spec.name);
      if (spec.many) {
         Entry list;
         list.key = spec.name;
         list.where = flat.deck.where(sections.empty() ? rk::Origin{} : sections.front()->origin);
         list.kind = 8;
         list.numbers = {static_cast<double>(sections.size())};
         flat.entries.push_back(list);
      }
      for (const rk::Section *section : sections)
         add_section(flat, *section);
   }
}

DeckView *open(rk::Deck deck) {
   Flat *flat = new Flat{{}, std::move(deck), {}, {}, {}};
   fill(*flat);
   look(*flat);
   return flat;
}

// Overrides come a line each
std::vector<std::string> lines(const char *text) {
   std::vector<std::string> found;
   std::istringstream stream(text);
   for (std::string line; std::getline(stream, line);) {
      if (!line.empty())
         found.push_back(line);
   }
   return found;
}

} // namespace

extern "C" {

// Read and check a file, or a text where there is one, for a command ("": for none)
DeckView *rk_deck_open(const char *path, const char *text, const char *overrides, const char *command) {
   rk::Deck deck = rk::is_blank(text) ? rk::Deck::read(path, lines(overrides))
                                      : rk::Deck(path, text, lines(overrides));
   deck.require(command);
   return open(std::move(deck));
}

// The full name of a key as an override would take it; "" where the status and message say why not
const char *rk_deck_resolve(DeckView *handle, const char *key) {
   thread_local std::string found;
   Flat &flat = *static_cast<Flat *>(handle);
   found = flat.deck.resolve(key);
   look(flat);
   return found.c_str();
}

void rk_deck_close(DeckView *handle) {
   delete static_cast<Flat *>(handle);
}

} // extern "C"
